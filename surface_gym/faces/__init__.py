"""What the single and the vector environments of every kind of batch share."""
