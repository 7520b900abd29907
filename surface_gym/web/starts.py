"""Starts of a task for a page, which cannot draw them: by seed, what a start is made of."""

import inspect
import math
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.wasm_image import is_scratch, name_arguments
from surface_gym.core.batch import BaseBatch
from surface_gym.physics import types as ph
from surface_gym.registration import PERIODS
from surface_gym.rendering import ExitSide, ExitSpeed, Heading, Path, StopLine
from surface_gym.scenes import exit_marks
from surface_gym.web.noise import describe_noise, place

SEEDS = 20  # for which a page has starts: 0, 1, 2 ...
PATH_STEP = 8  # points of a path between two that are drawn

Mark = dict[str, Any]  # as `page/draw.js` draws it: kind, points [m] and label


class Starts(NamedTuple):
    """Starts of several seeds: the arrays in which they differ, one seed's after another's."""

    fields: tuple[str, ...]  # names of the arrays
    block: bytes
    marks: list[list[Mark]]  # of each seed: its goal
    noise: dict[str, Any] | None  # as `page/noise.js` reads it; None: sensors draw none


def collect_starts(batch: BaseBatch, seeds: int = SEEDS) -> Starts:
    """Draw the starts of seeds 0, 1, 2 ...; the batch, of one environment, is left with seed 0's.

    A start is the one that the environment draws in `reset(seed=...)`, but for its noise, which a
    page draws.
    """
    kernel = batch.make_kernel()
    for seed in range(seeds):  # arrays grow to hold the largest
        place(batch, seed)
    found, marks, noise = [], [], []
    for seed in [*range(1, seeds), 0]:
        noise.append(place(batch, seed))
        named = name_arguments(kernel, batch.arguments)
        found.append({k: np.copy(v) for k, v in named.items() if not is_scratch(k)})
        marks.append(goal_marks(batch))
    found, marks, noise = ([each[-1], *each[:-1]] for each in (found, marks, noise))
    first = found[0]
    fields = tuple(
        k for k in first if any(each[k].tobytes() != first[k].tobytes() for each in found)
    )
    block = b"".join(each[name].tobytes() for each in found for name in fields)
    return Starts(fields, block, marks, describe_noise(batch, noise))


def goal_marks(batch: BaseBatch) -> list[Mark]:
    """Describe the goal of a batch's environment, which is placed, or its exits."""
    if hasattr(batch, "streams"):
        return _exits(batch)
    view, line = batch.view(0), batch.config.chosen_line
    goal = batch.config.task.goal(view)
    _, rows, first, columns = view.zone.tolist()
    half, deep = 0.5 * line.pitch_y * rows, 2.0 * line.pitch_y
    start, end = line.column_edge(first), line.column_edge(first + columns)
    middle = line.line_y

    def straight(label: str) -> list[Mark]:
        return [_area(end, end + deep, middle - half, middle + half, label)]

    if isinstance(goal, ExitSide) and goal.side == 0:
        return straight("out here")
    if isinstance(goal, ExitSide):
        beside = middle + goal.side * half
        return [_area(start, end, beside, beside + goal.side * deep, "out here")]
    if isinstance(goal, StopLine):
        points = [[goal.x, middle - half - deep], [goal.x, middle + half + deep]]
        return [{"kind": "line", "points": points, "label": "stop here"}]
    if isinstance(goal, ExitSpeed):
        return straight(f"out at {goal.speed:.2f} m/s")
    if isinstance(goal, Heading):
        turn = f"{math.degrees(goal.angle):+.0f}".replace("-", "\N{MINUS SIGN}")
        return straight(f"out turned to {turn}\N{DEGREE SIGN}")
    if isinstance(goal, Path):
        points = np.vstack([goal.points[:-1:PATH_STEP], goal.points[-1:]]).round(4).tolist()
        return [{"kind": "path", "points": points, "label": "follow this"}]
    return []


def _exits(batch: Any) -> list[Mark]:
    """Describe a stream's exits."""
    config = batch.config
    line = config.chosen_line
    first_row, rows, _, _ = config.rotors
    low = line.origin[1] + line.pitch_y * (first_row - 0.5)
    high, deep = low + line.pitch_y * rows, 2.0 * line.pitch_y
    marks = []
    for k, each in enumerate(exit_marks(config)):
        if each.side == 0:
            bottom, top = each.span or (low, high)
            marks.append(_area(each.first, each.last, bottom, top, each.name, k))
        else:
            beside = high if each.side > 0 else low
            area = (each.first, each.last, beside, beside + each.side * deep)
            marks.append(_area(*area, each.name, k))
    return marks


def _area(
    left: float, right: float, low: float, high: float, label: str, colour: int | None = None
) -> Mark:
    """Describe an exit."""
    points = [[left, low], [right, low], [right, high], [left, high]]
    mark: Mark = {"kind": "exit", "points": points, "label": label}
    return mark if colour is None else {**mark, "colour": colour}


def describe(batch: BaseBatch) -> dict[str, Any]:
    """Describe an environment for a page: what it draws and says of it, and how a player acts."""
    config = batch.config
    line, kind, task = config.chosen_line, config.action_kind, config.task
    name = config.task_name
    return {
        "task": name,
        "file": "" if name in PERIODS else inspect.getsourcefile(type(task)),
        "summary": (type(task).__doc__ or "").strip().splitlines()[0],
        "rows": line.rows,
        "columns": line.columns,
        "pitch": [line.pitch_x, line.pitch_y],
        "origin": list(line.origin),
        "zoneRows": kind.rows,
        "zoneColumns": kind.columns,
        "orientations": list(config.chosen_orientations),
        "dt": config.timing.dt,
        "steps": config.timing.steps,
        "periods": PERIODS.get(name),
        "outcomes": list(batch.outcomes),
        "terms": list(task.terms),
        "metrics": list(getattr(task, "metrics", ())),
        "stream": hasattr(batch, "streams"),
    }


# Rows of a scratch, for a page that draws contact forces.
CONTACTS = {
    name: getattr(ph, name)
    for name in (
        "ARM_X", "ARM_Y", "AXIS_X", "AXIS_Y", "MU_ALONG", "MU_ACROSS", "NORMAL", "ROTOR",
        "SPAN_FIRST", "SPAN_LAST", "SPANS", "CAPACITY", "TABLE_SIZE", "MARKS_SIZE",
    )
}  # fmt: skip
