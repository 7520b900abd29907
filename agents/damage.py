"""What reading a damaged or foreign file can raise, in PyYAML, in PyTorch and here."""

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
