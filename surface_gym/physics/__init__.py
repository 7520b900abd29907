"""The physics as compiled scalar functions, with slower reference solvers for tests."""
