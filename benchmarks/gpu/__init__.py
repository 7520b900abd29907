"""`python -m benchmarks --device cuda`: what a GPU makes of the same physics."""
