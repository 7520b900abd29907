"""Starts of a task for a page, which cannot draw starts itself.

There is a start for each of a few seeds, without sensor noise. Each start comes with the state of
the seed's random generator. The page draws the noise from this state.
"""

import inspect
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.jit import compiled
from surface_gym.compiler.random import Words, draw_normal, draw_uniform, read_words
from surface_gym.compiler.wasm_image import is_scratch, name_arguments
from surface_gym.config import EnvConfig
from surface_gym.core.batch import BaseBatch
from surface_gym.modules import surface_velocities
from surface_gym.physics import types as ph
from surface_gym.physics.types import Array
from surface_gym.registration import SHIPPED
from surface_gym.rendering import ExitSide, ExitSpeed, Heading, Path, StopLine
from surface_gym.scenes import exit_marks
from surface_gym.state import NOISE_ROWS

SEEDS = 20  # number of seeds with starts: 0, 1, 2 ...
PATH_STEP = 8  # step between drawn points of a path

Mark = dict[str, Any]  # mark for `page/draw.js`: kind, points [m] and label


class Starts(NamedTuple):
    """Starts of several seeds. `block` holds all arrays that differ between seeds, as bytes."""

    fields: tuple[str, ...]  # names of the arrays
    block: bytes
    marks: list[list[Mark]]  # goal marks of each seed
    noise: dict[str, Any] | None  # noise for the page; None: sensors draw none


def collect_starts(batch: BaseBatch, seeds: int = SEEDS) -> Starts:
    """Draw the starts of seeds 0, 1, 2 ... in a batch of one environment.

    The starts equal the environment's starts after `reset(seed=...)`, but without the noise, which
    the page draws. At the end, the batch is at the start of seed 0.
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
    """Return marks for the goal or the exits of the batch's first environment."""
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
    """Return marks for a stream's exits."""
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
    """Return the mark of an exit: a rectangle from x = `left` to `right`, y = `low` to `high` [m].

    `label` is the exit's text. `colour` is the index of the exit's colour. If `colour` is None,
    the exit has no colour of its own.
    """
    points = [[left, low], [right, low], [right, high], [left, high]]
    mark: Mark = {"kind": "exit", "points": points, "label": label}
    return mark if colour is None else {**mark, "colour": colour}


def describe(batch: BaseBatch) -> dict[str, Any]:
    """Return what a page needs to know of an environment: geometry, texts, actions and times."""
    config = batch.config
    line, kind, task = config.chosen_line, config.action_kind, config.task
    name = config.task_name
    return {
        "task": name,
        "file": "" if name in SHIPPED else inspect.getsourcefile(type(task)),
        "summary": (type(task).__doc__ or "").strip().splitlines()[0],
        "rows": line.rows,
        "columns": line.columns,
        "pitch": [line.pitch_x, line.pitch_y],
        "origin": list(line.origin),
        "zoneRows": kind.rows,
        "zoneColumns": kind.columns,
        "orientations": list(config.chosen_orientations),
        **_describe_choices(config),
        "dt": config.timing.dt,
        "steps": config.timing.steps,
        "periods": None if task.is_stream else task.periods,
        "outcomes": list(batch.outcomes),
        "terms": list(task.terms),
        "metrics": list(getattr(task, "metrics", ())),
        "stream": hasattr(batch, "streams"),
    }


def _describe_choices(config: EnvConfig) -> dict[str, Any]:
    """Return `rolling`, the index of the choice that lets parcels move along x, and `drives`.

    `drives` are the choices' surface velocities [m/s]. For idle modules, the list is empty.
    """
    velocities = surface_velocities(config.modes)
    apart = np.abs(config.modes[:-1] - config.modes[-1]).max(axis=1)
    drives = velocities[:-1].round(9).tolist() if config.module_kind.drives else []
    return {"rolling": int(apart.argmin()), "drives": drives}


# Rows of a scratch, for pages that draw contact forces.
CONTACTS = {
    name: getattr(ph, name)
    for name in (
        "ARM_X", "ARM_Y", "AXIS_X", "AXIS_Y", "MU_ALONG", "MU_ACROSS", "NORMAL", "ROTOR",
        "SPAN_FIRST", "SPAN_LAST", "SPANS", "CAPACITY", "TABLE_SIZE", "MARKS_SIZE",
    )
}  # fmt: skip


NORMALS = 3  # normal numbers per row of noise, followed by a uniform number
ONLY = np.zeros(1, dtype=np.int64)


class NoiseStart(NamedTuple):
    """States of a seed's random generator. A page draws sensor noise from these states."""

    first: list[str]  # state before drawing noise, as words in hexadecimal digits
    then: list[str]  # state after drawing the start
    drawn: int  # number of parcel rows with noise


class NotingGenerator(np.random.Generator):
    """Random generator that records its state before the first noise, and counts draws of noise."""

    def __init__(self, seed: int) -> None:
        super().__init__(np.random.default_rng(seed).bit_generator)
        self.first: list[str] | None = None
        self.drawn = 0

    def standard_normal(self, size: Any = None, *args: Any, **named: Any) -> Any:
        """Draw normal numbers as NumPy does. Count calls with the shape of sensor noise."""
        if size == (NOISE_ROWS, 3):
            self.first = self.first or write_state(self)
            self.drawn += 1
        return super().standard_normal(size, *args, **named)


def write_state(generator: np.random.Generator) -> list[str]:
    """Return the state of a PCG64 random generator, as words in hexadecimal digits."""
    return [f"{word:x}" for word in read_words(generator).view(np.uint64).tolist()]


@compiled
def draw_noise(words: Words, noise: Array) -> int:
    """Draw a parcel's noise (rows, NORMALS + 1) from a generator's state `words`; return 0."""
    for row in range(noise.shape[0]):
        for k in range(NORMALS):
            noise[row, k] = draw_normal(words)
    for row in range(noise.shape[0]):
        noise[row, NORMALS] = draw_uniform(words)
    return 0


def noise_arguments() -> tuple[Any, ...]:
    """Make example arguments of `draw_noise`. The compiler takes the types from the example."""
    return np.zeros(4, dtype=np.int64), np.zeros((NOISE_ROWS, NORMALS + 1))


def place(batch: BaseBatch, seed: int) -> NoiseStart | None:
    """Place the start of `reset(seed=...)` into a batch of one environment, without noise.

    Noise would take most of a start's bytes, so the page draws the noise. Return the states from
    which the page's random generator draws noise. If sensors draw no noise, return None.
    """
    generator = NotingGenerator(seed)
    batch.seed(0, generator)
    batch.place_drawn(ONLY)
    batch.parcels.noise[:] = 0.0
    if generator.first is None:
        return None
    return NoiseStart(generator.first, write_state(generator), generator.drawn)


def describe_noise(batch: BaseBatch, starts: Sequence[NoiseStart | None]) -> dict[str, Any] | None:
    """Return the generator states of all starts, and the number of noise rows per control period.

    If sensors draw no noise, return None.
    """
    if not batch.config.draws:
        return None
    return {
        "used": batch.config.draws,  # maximum rows of noise per control period
        "states": [each._asdict() for each in starts if each is not None],
    }
