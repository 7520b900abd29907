"""What needs Optuna, of the extra `search`, is left out where it is missing."""

from importlib.util import find_spec

NEED_IT = ["test_command.py", "test_report.py", "test_study.py", "test_trial.py"]
collect_ignore = [] if find_spec("optuna") else NEED_IT
