"""What the planner is made of: the start it takes for true, its model, its aims and the search."""
