"""Batches of environments, and the functions and memory that they are assembled from."""
