"""Each environment's page, from its docstring and its tables: `python -m surface_gym.pages DIR`."""

import argparse
import inspect
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from surface_gym.env import SmartSurfaceEnv
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS, Task


def _table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [header, tuple("---" for _ in header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _observation_table(task: Task) -> str:
    rows = (
        (str(place), feature.name, feature.meaning, f"{feature.low:g}", f"{feature.high:g}")
        for place, feature in enumerate(task.features)
    )
    return _table(("place", "feature", "meaning / unit", "least", "most"), rows)


def _argument_table(task_class: type[Any]) -> str:
    """Fields of a task with their defaults and the comments behind them."""
    kinds = (kind for kind in task_class.__mro__ if kind is not object)
    source = [line for kind in kinds for line in inspect.getsource(kind).splitlines()]
    rows = []
    for field in fields(task_class):
        line = next(line for line in source if line.strip().startswith(f"{field.name}:"))
        comment = line.partition("  # ")[2]
        rows.append((f"`{field.name}`", f"`{field.default!r}`", comment))
    return _table(("argument of the task", "default", "meaning"), rows)


def page(name: str) -> str:
    """The Markdown page of a task's environment."""
    task_class = TASKS[name]
    task = task_class()
    period = inspect.signature(SmartSurfaceEnv).parameters["control_period"].default
    limit = task_class.periods
    return (
        "\n\n".join(
            (
                f"# {env_id(name)}",
                inspect.cleandoc(task_class.__doc__ or ""),
                "## Observation",
                _observation_table(task),
                'With `actions="window"` 25 more follow: the occupancy of the window.',
                "## Reward terms",
                ", ".join(f"`{term}`" for term in task.terms)
                + ', as dict in `info["reward_terms"]`.',
                "## Options of `reset`",
                ", ".join(f"`{option}`" for option in task.options),
                "## Arguments of the task",
                _argument_table(task_class),
                f"Episodes are truncated after {limit} control periods, {limit * period:g} s.",
                "Actions, sensors and the environment's own arguments: "
                "[the environment](environment.md).",
            )
        )
        + "\n"
    )


def environment_page() -> str:
    """The Markdown page of what all environments share."""
    listed = "\n".join(f"- [{env_id(name)}]({name}.md)" for name in TASKS)
    body = inspect.cleandoc(SmartSurfaceEnv.__doc__ or "")
    return f"# SmartSurfaceEnv\n\n{body}\n\n## Tasks\n\n{listed}\n"


def pages() -> dict[str, str]:
    """Every page by its file's name."""
    return {"environment.md": environment_page(), **{f"{name}.md": page(name) for name in TASKS}}


def main(arguments: list[str] | None = None) -> None:
    """Write the pages into a folder."""
    parser = argparse.ArgumentParser(prog="python -m surface_gym.pages", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder to write the pages to")
    folder: Path = parser.parse_args(arguments).folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (folder / name).write_text(text)


if __name__ == "__main__":
    main()
