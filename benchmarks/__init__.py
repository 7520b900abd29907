"""What surface_gym costs and how exact it is, measured: `python -m benchmarks --help`."""
