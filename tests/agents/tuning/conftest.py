"""What needs Optuna, of the extra `search`, is left out where it is missing."""

from importlib.util import find_spec

collect_ignore = [] if find_spec("optuna") else ["test_study.py"]
