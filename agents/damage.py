"""What reading a damaged file can raise, in PyYAML, in PyTorch and here, and how it is told."""

from pickle import UnpicklingError

import yaml

DAMAGE = (
    yaml.YAMLError,
    UnpicklingError,
    EOFError,
    OSError,
    AttributeError,
    KeyError,
    RuntimeError,
    TypeError,
    ValueError,
)


def told(error: Exception) -> str:
    """What is wrong with the file, in one line, without a library's advice on how to read it."""
    if isinstance(error, UnpicklingError):
        return "it holds more than tensors and plain values"
    if isinstance(error, KeyError):
        return f"{error} is missing"
    return " ".join(str(error).split()) or "it is cut short"
