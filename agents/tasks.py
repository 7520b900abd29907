"""Tasks by name: those of the package, and a user's own as "path/to/file.py:Class"."""

import hashlib
import importlib.util
import sys
from pathlib import Path
from typing import Any

from surface_gym.config import EnvConfig
from surface_gym.registration import FLOW, env_id
from surface_gym.tasks import TASKS, Task

from .base import FLOW_TASK
from .library import OWN


def find_task(name: str) -> Task:
    """Make the task of a name; a file in the name is run."""
    if name in TASKS:
        return TASKS[name]()
    file, colon, kind = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        raise ValueError(
            f"task must be one of {', '.join(TASKS)}, or your own as path/to/file.py:Class, "
            f"got {name!r}"
        )
    found = getattr(_load_module(Path(file)), kind, None)
    if not (isinstance(found, type) and issubclass(found, Task)):
        raise ValueError(f"task must be a class of {file} that inherits from Task, got {kind!r}")
    return found()


def task_kind(name: str) -> str:
    """Name the package's task that a task is or inherits from; else the task itself."""
    return name if name in TASKS else EnvConfig(task=find_task(name)).task_name


def task_label(name: str) -> str:
    """Shorten a task's name for tables and names of files."""
    return name.rpartition(":")[2].lower()


def card_env_id(name: str) -> str:
    """Name the environment of a task for a policy's card: its id, or "Own/Class"."""
    if name == FLOW_TASK:
        return FLOW
    return env_id(name) if name in TASKS else OWN + name.rpartition(":")[2]


def task_files(name: str | None) -> tuple[Path, ...]:
    """List the file of a user's own task, which other machines need; none for the package's."""
    return (Path(name.rpartition(":")[0]),) if name is not None and ":" in name else ()


def _load_module(file: Path) -> Any:
    """Run a file's module, once in a process."""
    if not file.is_file():
        raise ValueError(f"task must be in a file that exists, got {file}")
    place = str(file.resolve())
    name = f"_own_{file.stem}_{hashlib.sha256(place.encode()).hexdigest()[:8]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, place)
        assert spec is not None
        assert spec.loader is not None
        module = sys.modules[name] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            del sys.modules[name]
            raise ValueError(
                f"task must be in a file that runs, got {file}: {type(error).__name__}: {error}"
            ) from error
    return sys.modules[name]
