"""Batches of environments, with the functions and memory that they consist of."""
