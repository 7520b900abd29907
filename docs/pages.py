"""Each environment's page, from its docstring and its tables: `python docs/pages.py DIR`."""

import argparse
import inspect
import re
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow.task import Flow
from surface_gym.registration import FLOW, env_id
from surface_gym.tasks import TASKS
from surface_gym.tasks.base import Feature

LONGEST_DEFAULT = 60  # characters of a default in a table
# Lines from a prompt to the next empty one, as far left as the text around them.
EXAMPLE = re.compile(r"^>>> .*(?:\n.+)*", re.MULTILINE)


def _described(kind: type[Any]) -> str:
    """Return a class's docstring, its examples fenced as code."""
    return EXAMPLE.sub(r"```pycon\n\g<0>\n```", inspect.cleandoc(kind.__doc__ or ""))


def _film(name: str, caption: str) -> str:
    return f"![{caption}](../images/{name}.webp)"


def _table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [header, tuple("---" for _ in header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _feature_table(features: Iterable[Feature]) -> str:
    rows = (
        (str(place), feature.name, feature.meaning, f"{feature.low:g}", f"{feature.high:g}")
        for place, feature in enumerate(features)
    )
    return _table(("place", "feature", "meaning / unit", "least", "most"), rows)


def _argument_table(kind: type[Any]) -> str:
    """Tabulate a dataclass's fields, their defaults and the comments behind or above them."""
    source = [
        line.strip()
        for each in kind.__mro__
        if each is not object
        for line in inspect.getsource(each).splitlines()
    ]
    rows = []
    for field in fields(kind):
        if not field.init and kind is not EnvConfig:
            continue
        at = next(
            k
            for k, line in enumerate(source)
            if line.startswith(f"{field.name}: ") and " = " in line
        )
        comment = source[at].partition("  # ")[2]
        while not comment.startswith("# ") and source[at - 1].startswith("# "):
            at -= 1
            comment = f"{source[at].removeprefix('# ')} {comment}".strip()
        default = repr(field.default)
        if len(default) > LONGEST_DEFAULT:
            default = f"{type(field.default).__name__}()"
        rows.append((f"`{field.name}`", f"`{default}`", comment))
    return _table(("argument", "default", "meaning"), rows)


ENVIRONMENT = "[the environment](environment.md)."


def _join(*parts: str) -> str:
    return "\n\n".join(parts) + "\n"


def page(name: str) -> str:
    """Write the Markdown page of a task's environment."""
    task_class = TASKS[name]
    task = task_class()
    period = inspect.signature(SmartSurfaceEnv).parameters["control_period"].default
    limit = task_class.periods
    return _join(
        f"# {env_id(name)}",
        _film(name, f"Episodes of {env_id(name)}"),
        _described(task_class),
        "## Observation",
        _feature_table(task.features),
        'With `actions="window"` 25 more follow: the occupancy of the window.',
        "## Reward terms",
        ", ".join(f"`{term}`" for term in task.terms)
        + ", each in `info` as `reward_` and its name.",
        "## Options of `reset`",
        ", ".join(f"`{option}`" for option in task.options),
        "## Arguments of the task",
        _argument_table(task_class),
        f"Episodes are truncated after {limit} control periods, {limit * period:g} s.",
        f"Actions, sensors and the environment's own arguments: {ENVIRONMENT}",
    )


def environment_page() -> str:
    """Write the Markdown page of what all environments share."""
    return _join(
        "# SmartSurfaceEnv",
        _described(SmartSurfaceEnv),
        "## Arguments of every environment",
        _argument_table(EnvConfig),
        "## Tasks",
        "\n".join(f"- [{env_id(name)}]({name}.md)" for name in TASKS),
        f"Many parcels at once: [{FLOW}](flow.md).",
    )


def flow_page() -> str:
    """Write the Markdown page of the environment of many parcels."""
    return _join(
        f"# {FLOW}",
        _film("flow", f"A stream of {FLOW}"),
        _described(Flow),
        "## Features of a row",
        _feature_table(Flow.features),
        "## Arguments of the task",
        _argument_table(Flow),
        f"Actions, sensors and the environment's other arguments: {ENVIRONMENT}",
        "Streams, exits, the physics of parcels that touch, and controllers: "
        "[a flow of parcels](../flow.md).",
    )


def pages() -> dict[str, str]:
    """Write every page, by its file's name."""
    return {
        "environment.md": environment_page(),
        **{f"{name}.md": page(name) for name in TASKS},
        "flow.md": flow_page(),
    }


def main(arguments: list[str] | None = None) -> None:
    """Write the pages into a folder."""
    parser = argparse.ArgumentParser(prog="python docs/pages.py", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder to write the pages to")
    folder: Path = parser.parse_args(arguments).folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (folder / name).write_text(text)


if __name__ == "__main__":
    main()
