"""Each environment's page, from its docstring and its tables: `python docs/pages.py DIR`."""

import argparse
import inspect
import itertools
import math
import re
import textwrap
from collections.abc import Iterable
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

from gymnasium.spaces import Discrete

from surface_gym import registration
from surface_gym.actions import KINDS
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow.base import ACTIONS, OF_ONE_PARCEL, StreamTask
from surface_gym.registration import DEFAULT_STREAM, env_id
from surface_gym.tasks import TASKS
from surface_gym.tasks.base import Task
from surface_gym.tasks.features import Feature

# Tasks on streams of parcels, and the guide to which each page leads on.
STREAMS = {
    DEFAULT_STREAM: "[a flow of parcels](../flow.md)",
    **dict.fromkeys(
        ("singulate", "merge", "sequence"), "[material flow on a slope](../material-flow.md)"
    ),
}
# The task whose page has a task's first features, and a stream's other arguments.
BASES = {
    **dict.fromkeys(("stop", "orient", "park"), "slow"),
    DEFAULT_STREAM: "sort",
    "singulate": DEFAULT_STREAM,
    **dict.fromkeys(("merge", "sequence"), "singulate"),
}
WIDTH = 120  # characters of a line
LONGEST_DEFAULT = 60  # characters of a default in a table
# Lines from a prompt to the next empty one, and the heading above them, if any.
EXAMPLE = re.compile(r"(?:^### Example\n\n)?^ *>>> .*(?:\n.+)*\n\n", re.MULTILINE)


def _opening(kind: type[Any], title: str, *top: str) -> str:
    """Open a page: title, film, first paragraph, `top`, the example, and then the docstring."""
    text = inspect.cleandoc(kind.__doc__ or "") + "\n\n"
    found = EXAMPLE.search(text)
    if found is None:
        raise ValueError(f"the docstring of {kind.__name__} must have an example")
    first, rest = EXAMPLE.sub("", text).split("\n\n", 1)
    lines = textwrap.dedent(found[0].removeprefix("### Example\n\n")).strip()
    example = f"```pycon\n{lines}\n```"
    return _join(f"# {title}", *top[:1], _wrap(first), *top[1:], example, _wrap(rest)).strip()


def _wrap(text: str) -> str:
    """Break a docstring's lines as those of the other pages; tables and code stay."""
    blocks = []
    for block in text.split("\n\n"):
        if block.startswith(("|", "#", "    ", "```")):
            blocks.append(block)
            continue
        entries = re.split(r"\n(?=- )", block)
        blocks.append(
            "\n".join(
                textwrap.fill(
                    " ".join(entry.split()),
                    width=WIDTH,
                    subsequent_indent="  " if entry.startswith("- ") else "",
                    break_long_words=False,
                    break_on_hyphens=False,
                )
                for entry in entries
            )
        )
    return "\n\n".join(blocks)


def _film(name: str, caption: str) -> str:
    return f"![{caption}](../images/{name}.webp)"


def _space(config: EnvConfig) -> str:
    """Describe a space of actions in a table."""
    space: Any = config.action_space()
    if isinstance(space, Discrete):
        return f"`Discrete({space.n})`"
    (choices,) = set(space.nvec.tolist())
    return f"`MultiDiscrete`, {len(space.nvec)} numbers of 0 to {choices - 1}"


def _choices(task: str) -> str:
    """Say which angles the numbers of an action choose, and for which modules."""
    config = EnvConfig(task)
    angles = ", ".join(f"{math.degrees(angle):g}" for angle in config.chosen_orientations)
    text = f"The numbers 0 to {config.choices - 1} choose axis angles of {angles} deg. "
    if task in STREAMS:
        rotor: Any = config.task.line.rotor
        supports = sum(not any(column) for column in zip(*rotor, strict=True))
        rows = sum(any(row) for row in rotor)
        space: Any = config.action_space()
        text += (
            f'"modules" has {rows} rows x {len(space.nvec) // rows} columns; the last {supports} '
            'columns are supports, and ignore their numbers. "parcels" has two numbers per row of '
            "the observation: for the modules ahead of the parcel's centre and behind it. "
        )
    else:
        text += (
            '"halves" has one number, 4 a + b: choice a for the modules ahead of the parcel\'s '
            "centre, b for the modules behind it. "
        )
    return text + "See [kinds of action](environment.md#actions)"


def _overview(task: str) -> str:
    """Tabulate an environment's spaces, as Gymnasium's pages do."""
    kinds = ACTIONS if task in STREAMS else KINDS
    acting = [f'{_space(EnvConfig(task, actions=kind))} with `actions="{kind}"`' for kind in kinds]
    space: Any = EnvConfig(task).observation_space()
    features = f"#{_features_heading(task)}".replace(" ", "-").lower()
    shown = f"`Box(shape={space.shape}, {space.dtype})`: [features]({features})"
    acts = ";<br>".join([f"{acting[0]}, the default", *acting[1:]])
    acts += f".<br>{_choices(task)}"
    shown += ". theta is a parcel's angle; vx, vy and omega are its velocities. "
    shown += "[Ten words](../index.md#ten-words) explains S-box, zone and other terms"
    return _table(("", ""), (("Action space", acts), ("Observation space", shown)))


def _table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [header, tuple("---" for _ in header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _features_heading(task: str) -> str:
    return "Features of a row" if task in STREAMS else "Observation"


def _feature_rows(features: tuple[Feature, ...], first: int) -> list[tuple[str, ...]]:
    """Return a table's rows from a feature on.

    Features of the neighbour behind are one row, as are successive features that differ only in
    their names.
    """
    rows: list[tuple[str, ...]] = []
    behind = [each for each in features if each.name.endswith(" behind")]
    for place, each in enumerate(features[first:], first):
        like = replace(each, name=each.name.replace(" behind", " ahead"))
        if each not in behind or like not in features:
            rest = each.meaning, each.formula, f"{each.low:g}", f"{each.high:g}"
            if rows and rows[-1][2:] == rest:
                start, names = rows[-1][0].partition(" to ")[0], rows.pop()[1]
                rows.append((f"{start} to {place}", f"{names}, {each.name}", *rest))
            else:
                rows.append((str(place), each.name, *rest))
        elif each is behind[-1]:
            names = ", ".join(other.name for other in behind)
            start, ahead = place - len(behind) + 1, place - 2 * len(behind) + 1
            text = f"as features {ahead} to {start - 1}, for the next parcel behind"
            rows.append((f"{start} to {place}", names, text, "", "", ""))
    return rows


def _features(task: str) -> str:
    """Tabulate a task's features; the first ones may be on another task's page."""
    features, base = registration.TASKS[task].features, BASES.get(task)
    same = 0
    if base is not None:
        pairs = zip(features, registration.TASKS[base].features, strict=False)
        same = sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs))
    table = _table(
        ("index", "feature", "value", "observed as", "lower bound", "upper bound"),
        _feature_rows(features, same),
    )
    if not same:
        return table
    page = f"{base}.md#{_features_heading(str(base))}".replace(" ", "-").lower()
    return f"Features 0 to {same - 1} are as in [{str(base).capitalize()}]({page}).\n\n{table}"


def _argument_table(kind: type[Any], without: type[Any] | None = None) -> str:
    """Tabulate a dataclass's fields, their defaults and the comments behind or above them.

    Fields that another class has with the same default are left out.
    """
    same, usual = {} if without is None else _defaults(without), _defaults(kind)
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
        if issubclass(kind, StreamTask) and field.name in OF_ONE_PARCEL:
            continue
        value = usual[field.name]
        if field.name in same and same[field.name] == value:
            continue
        places = [
            at
            for at, line in enumerate(source)
            if line.startswith(f"{field.name}: ") and (" = " in line or "  # " in line)
        ]
        comment = next(filter(None, (_comment(source, at) for at in places)), "")
        default = _default(value, source[places[0]])
        rows.append((f"`{field.name}`", f"`{default}`", comment))
    return _table(("argument", "default", "meaning"), rows)


def _defaults(kind: type[Any]) -> dict[str, Any]:
    """Return the defaults of a dataclass's fields; `Task` itself has no instance."""
    declared = {field.name: field.default for field in fields(kind) if field.default is not MISSING}
    return declared if kind is Task else {**vars(kind()), **declared}


def _default(value: Any, line: str) -> str:
    """Write a default: its value, or where that is long the call that makes it, or its type."""
    text = re.sub(r"\d+\.\d{5,}", lambda number: f"{float(number[0]):.4g}", repr(value))
    if isinstance(value, float) and float(text) == value:
        return repr(value)
    if len(text) <= LONGEST_DEFAULT:
        return text
    made = re.search(r" = (\w+\([^()]*\))(?:  #|$)", line)
    return made[1] if made else f"{type(value).__name__}()"


def _comment(source: list[str], at: int) -> str:
    """Return the comment behind a line of source code, and those above it."""
    comment = source[at].partition("  # ")[2]
    while source[at - 1].startswith("# "):
        at -= 1
        comment = f"{source[at].removeprefix('# ')} {comment}".strip()
    return comment


def _join(*parts: str) -> str:
    return "\n\n".join(parts) + "\n"


def page(name: str) -> str:
    """Write the Markdown page of a task's environment."""
    task_class = TASKS[name]
    task = task_class()
    period = inspect.signature(SmartSurfaceEnv).parameters["control_period"].default
    limit = task_class.periods
    return _join(
        _opening(
            task_class, env_id(name), _film(name, f"Episodes of {env_id(name)}"), _overview(name)
        ),
        f"## {_features_heading(name)}",
        _features(name),
        "## Arguments of the task",
        _argument_table(task_class, Task),
        _wrap(
            "`reset` options: " + ", ".join(f"`{option}`" for option in task.options) + ". "
            f"Time limit: {limit} periods, {limit * period:g} s. "
            "[Other arguments](environment.md)."
        ),
    )


def environment_page() -> str:
    """Write the Markdown page of what all environments share."""
    return _join(
        _opening(SmartSurfaceEnv, "SmartSurfaceEnv"),
        "## Arguments of every environment",
        _argument_table(EnvConfig),
        "All tasks of one parcel also have:",
        _argument_table(Task),
    )


def stream_page(name: str) -> str:
    """Write the Markdown page of a task's environment of many parcels."""
    kind, title = registration.TASKS[name], env_id(name)
    assert issubclass(kind, StreamTask)
    base = BASES[name]
    arguments = [_argument_table(kind)]
    if base in STREAMS:
        arguments = [
            f"All [arguments of {base.capitalize()}]({base}.md#arguments-of-the-task); these are "
            "new or have other defaults:",
            _argument_table(kind, registration.TASKS[base]),
        ]
    return _join(
        _opening(kind, title, _film(name, f"A stream of {title}"), _overview(name)),
        f"## {_features_heading(name)}",
        _features(name),
        "## Arguments of the task",
        *arguments,
        _wrap(
            f"[The environment](environment.md) has all other arguments; {STREAMS[name]} has rules."
        ),
    )


def pages() -> dict[str, str]:
    """Write every page, by its file's name."""
    return {
        "environment.md": environment_page(),
        **{f"{name}.md": page(name) for name in TASKS},
        **{f"{name}.md": stream_page(name) for name in STREAMS},
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
