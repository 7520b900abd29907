"""Tasks by name: the package's, and those of one's own, "path/to/file.py:Class"."""

import hashlib
import importlib.util
import sys
from pathlib import Path
from typing import Any

from surface_gym.registration import FLOW, env_id
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS, Task

from .policy_card import FLOW_TASK, OWN


def find_task(name: str) -> Task:
    """The task of a name. A file that the name says is run.

    Raises:
        ValueError: no task of the package has that name, and it says no file and class; there is
            no such file, it does not run, or it holds no such task.
    """
    if name in TASKS:
        return TASKS[name]()
    file, colon, kind = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        raise ValueError(
            f"task must be one of {', '.join(TASKS)}, or one's own as path/to/file.py:Class, "
            f"got {name!r}"
        )
    found = getattr(_module(Path(file)), kind, None)
    if not (isinstance(found, type) and issubclass(found, Task)):
        raise ValueError(f"task must be a class of {file} that inherits from Task, got {kind!r}")
    return found()


def kind_of(name: str) -> str:
    """The name of the package's task that a task is or inherits from; else its own."""
    return name if name in TASKS else Settings(task=find_task(name)).task_name


def label_of(name: str) -> str:
    """A task's name in tables and in names of files."""
    return name.rpartition(":")[2].lower()


def id_of(name: str) -> str:
    """What a policy's card calls the environment of a task: its id, or "Own/Class"."""
    if name == FLOW_TASK:
        return FLOW
    return env_id(name) if name in TASKS else OWN + name.rpartition(":")[2]


def files_of(name: str | None) -> tuple[Path, ...]:
    """The file of a task of one's own, which other machines need; none for one of the package."""
    return (Path(name.rpartition(":")[0]),) if name is not None and ":" in name else ()


def _module(file: Path) -> Any:
    """A file's module, run once a process."""
    if not file.is_file():
        raise ValueError(f"task must be in a file that is there, got {file}")
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
