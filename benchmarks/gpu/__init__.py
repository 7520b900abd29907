"""`python -m benchmarks --device cuda`: speed of the vector environment on a GPU."""


class NotMeasured(RuntimeError):
    """Error: a measurement of this package failed."""
