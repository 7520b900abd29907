"""Benchmarks of surface_gym's speed and accuracy: `python -m benchmarks --help`."""
