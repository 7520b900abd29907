"""Resets: drawing starts of episodes ahead, placing parcels, and drawing noise of sensors."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks, state as st
from surface_gym.config import EnvConfig
from surface_gym.lines import BaseLine
from surface_gym.parcel import NO_EDGE, Parcel, filled_up
from surface_gym.physics.step import com_states, split_gravity
from surface_gym.physics.types import Array, Booleans, Integers
from surface_gym.tasks.base import Task
from surface_gym.tasks.start import Draw, Parcels, Start


def draw_noise(parcels: st.ParcelState, row: int, generator: np.random.Generator) -> None:
    """Draw all sensor noise of one parcel, the parcel in row `row` of the state `parcels`.

    A sensor uses three normal numbers and one uniform number per frame.
    """
    noise = parcels.noise[row]
    noise[:, :3] = generator.standard_normal((st.NOISE_ROWS, 3))
    noise[:, 3] = generator.random(st.NOISE_ROWS)
    parcels.noise_row[row] = 0


class Placement(NamedTuple):
    """Rows of state arrays. The contents of these rows depend only on the parcel and the line."""

    rotor: Booleans  # (rows, columns)
    obeys: Booleans  # (rows, columns) without randomly stuck modules
    zone: Integers  # (4,) first row, rows, first column, columns
    body: Array  # (7,) as `Bodies.body`
    edges: Array  # (edges, 3)
    corners: Array  # (corners, 2) [m] from the centroid

    @property
    def sides(self) -> int:
        return max(len(self.edges), len(self.corners))


@lru_cache(maxsize=64)
def place_parcel(
    parcel: Parcel,
    line: BaseLine,
    zone: tuple[int, int] | None,
    stuck: tuple[tuple[int, int], ...] = (),
) -> Placement:
    """Return the rows of the state arrays for a parcel on a line.

    `zone` is the first and the last column that obey; None means the line's zone. `stuck` lists
    (row, column) of modules that never obey.
    """
    placed = line.site(parcel.base, zone)
    first_row, rows, first_column, columns = placed.zone
    obeys = np.zeros_like(placed.rotor)
    obeys[first_row : first_row + rows, first_column : first_column + columns] = True
    for row, column in stuck:
        obeys[row, column] = False
    zone_numbers = np.array(placed.zone)
    edges, corners = parcel.body.edges, parcel.corners
    return Placement(placed.rotor, obeys & placed.rotor, zone_numbers, parcel.row, edges, corners)


def place_in(config: EnvConfig, parcel: Parcel) -> Placement:
    """Return a parcel's `Placement` on the line and zone of an environment's configuration."""
    stuck = tuple(config.actuators.stuck)
    return place_parcel(parcel, config.chosen_line, config.zone, stuck)


FEWEST_EDGES = 4
_NEW = count(1)  # a new number for every content of a row


class HeldParcels(NamedTuple):
    """Parcels of some environments, copied from rows of the body table."""

    body: Integers  # (count,)
    parcel: np.ndarray  # (count,) of `Parcel`
    obeys: Booleans  # (count, rows, columns), or empty if all share their rows
    content: Integers  # (count,) number of the row's content

    def __len__(self) -> int:
        return len(self.body)


class BodyPlan:
    """Body table of a batch. Each parcel of the task has a row, and each environment has a row."""

    def __init__(
        self,
        parcels: Sequence[Parcel],
        place: Callable[[Parcel], Placement],
        num_envs: int,
        shape: tuple[int, int],
    ) -> None:
        self._place = place
        self._num_envs = num_envs
        self._shared = len(parcels)
        self._parcels: np.ndarray = np.full(self._shared + num_envs, None, dtype=object)
        self._row_of = {parcel: body for body, parcel in enumerate(parcels)}
        self._content = np.zeros(self._shared + num_envs, dtype=np.int64)
        # (rows, 4) length, width [m], mass [kg] and height of the centre of mass [m]
        self.sizes: Array = np.zeros((self._shared + num_envs, 4))
        self.bodies = _make_bodies(self._shared, shape, FEWEST_EDGES)
        for body, parcel in enumerate(parcels):
            self._write(body, parcel)

    def shared_bodies_of(self, parcels: Parcels) -> Integers:
        """Return the parcels' rows (count,) in the body table, or -1 for an unknown parcel."""
        found = np.array([self._row_of.get(parcel, -1) for parcel in parcels.kinds])
        return found[parcels.which]

    def bodies_of(self, chosen: Integers, parcels: Parcels) -> Integers:
        """Return the parcels' rows (count,) in the body table; write parcels that have no row."""
        bodies = self.shared_bodies_of(parcels)
        for k in np.nonzero(bodies < 0)[0].tolist():
            bodies[k] = self._own(int(chosen[k]), parcels.kinds[parcels.which[k]])
        return bodies

    def draw_stuck(self, i: int, parcel: Parcel, working: Booleans) -> int:
        """Write a parcel into environment i's row of the body table; return the row's index.

        `working` (rows, columns) marks the modules that are not stuck. Only these modules obey.
        """
        body = self._own(i, parcel)
        self.bodies.obeys[body] = self._place(parcel).obeys & working
        self._content[body] = next(_NEW)
        return body

    def parcel(self, body: int) -> Parcel:
        """Return the parcel in row `body` of the body table."""
        parcel = self._parcels[body]
        assert isinstance(parcel, Parcel)
        return parcel

    def copy(self, bodies: Integers) -> HeldParcels:
        """Copy the parcels in rows `bodies` (count,), and their masks of obeying modules."""
        own = bool((bodies >= self._shared).any())
        obeys = self.bodies.obeys[bodies if own else bodies[:0]]
        return HeldParcels(bodies.copy(), self._parcels[bodies], obeys, self._content[bodies])

    def put(self, chosen: Integers, held: HeldParcels) -> Integers:
        """Put the copied parcels `held` into the chosen environments (count,).

        `held` has one parcel per chosen environment, or one parcel for all. Return the parcels'
        rows (count,) of the body table.
        """
        bodies = np.broadcast_to(held.body, len(chosen)).copy()
        for k in np.nonzero(bodies >= self._shared)[0].tolist():
            source = k if len(held) > 1 else 0
            body = bodies[k] = self._shared + int(chosen[k])
            parcel, content = held.parcel[source], held.content[source]
            if self._content[body] != content or self._parcels[body] is not parcel:
                self._own(int(chosen[k]), parcel)
                self.bodies.obeys[body] = held.obeys[source]
                self._content[body] = content
        return bodies

    def _own(self, i: int, parcel: Parcel) -> int:
        body = self._shared + i
        if len(self.bodies.zone) == self._shared:
            more = _make_bodies(
                self._num_envs, self.bodies.rotor.shape[1:], self.bodies.edges.shape[1]
            )
            self.bodies = st.BodyTable._make(
                map(np.concatenate, zip(self.bodies, more, strict=True))
            )
        if self._parcels[body] is not parcel:
            self._write(body, parcel)
        return body

    def _write(self, body: int, parcel: Parcel) -> None:
        placement = self._place(parcel)
        self.bodies = with_body(self.bodies, body, placement)
        self.bodies.rotor[body] = placement.rotor
        self.bodies.obeys[body] = placement.obeys
        self.bodies.zone[body] = placement.zone
        length, width = np.ptp(parcel.base.outline, axis=0)
        self.sizes[body] = length, width, parcel.mass, parcel.com_height
        self._parcels[body] = parcel
        self._content[body] = next(_NEW)


def with_body(bodies: st.BodyTable, body: int, placement: Placement) -> st.BodyTable:
    """Write a placement to row `body` of a table. Return the table, with room for all edges."""
    wide = bodies.edges.shape[1]
    more = placement.sides - wide
    if more > 0:
        no_edges = np.tile(NO_EDGE, (len(bodies.edges), more, 1))
        repeats = np.repeat(bodies.corners[:, :1], more, axis=1)
        bodies = bodies._replace(
            edges=np.concatenate([bodies.edges, no_edges], axis=1),
            corners=np.concatenate([bodies.corners, repeats], axis=1),
        )
    bodies.body[body] = placement.body
    edges, corners = filled_up(placement.edges, placement.corners, wide + max(0, more))
    bodies.edges[body], bodies.corners[body] = edges, corners
    return bodies


def _make_bodies(count: int, shape: tuple[int, ...], edges: int) -> st.BodyTable:
    return st.BodyTable(
        rotor=np.zeros((count, *shape), dtype=np.bool_),
        obeys=np.zeros((count, *shape), dtype=np.bool_),
        body=np.zeros((count, 7)),
        edges=np.zeros((count, edges, 3)),
        corners=np.zeros((count, edges, 2)),
        zone=np.zeros((count, 4), dtype=np.int64),
    )


class StartRows(NamedTuple):
    """Starts of episodes, as rows of the state arrays."""

    body: Integers  # (starts,)
    state: Array  # (starts, STATE_SIZE)
    conditions: Array  # (starts, 6)
    goal: Array  # (starts, goals)


def draw_starts(config: EnvConfig, numbers: Array, options: Sequence[Mapping[str, Any]]) -> Start:
    """Return a task's starts from uniform random numbers (starts, draws) and options.

    `options` holds the reset options of each start, or is empty.
    """
    task = config.task
    start = task.displaced_start(Draw(numbers, options, config.chosen_line, config.zone))
    if not isinstance(start, Start):
        raise ValueError(f"{type(task).__name__}.start must give a Start, got {start!r}")
    return start


def start_rows(task: Task, start: Start, parcels: Parcels, bodies: Integers) -> StartRows:
    """Return starts as rows of the state arrays; `bodies` (starts,) are rows of the body table."""
    count = len(bodies)
    pose = _columns(task, "pose", start.pose, 3, count)
    velocity = _columns(task, "velocity", start.velocity, 3, count)
    tilt, direction = _columns(task, "tilt", (start.tilt, start.tilt_direction), 2, count).T
    author = f"{type(task).__name__}.start"
    checks.limited(f"pose of {author}", pose, checks.MOST_POSE)
    checks.limited(f"velocity of {author}", velocity, checks.MOST_VELOCITY)
    checks.angles(f"tilt of {author}", tilt, math.pi / 4)
    checks.angles(f"tilt_direction of {author}", direction)
    conditions = np.ones((count, st.CONDITION_COLUMNS))
    conditions[:, st.GRAVITY_COLUMNS] = np.transpose(split_gravity(tilt, direction))
    goal = _columns(task, "goal", start.goal, task.goals, count)
    state = com_states(parcels.of(lambda parcel: parcel.centre_of_mass), pose, velocity)
    return StartRows(bodies, state, conditions, goal)


def _columns(task: Task, name: str, values: Sequence[Any], wanted: int, count: int) -> Array:
    """Return the `values` of a start's field `name` as an array (count, wanted).

    A value is a number or an array (count,). Raise a ValueError if the number of values is not
    `wanted`, or if a value is not finite.
    """
    expected = f"{type(task).__name__}.start must give a {name} of"
    if len(values) != wanted:
        raise ValueError(f"{expected} {wanted} numbers, got {len(values)}")
    columns = np.empty((count, wanted))
    for k, value in enumerate(values):
        try:
            columns[:, k] = value
        except (TypeError, ValueError):
            raise ValueError(f"{expected} numbers or arrays ({count},), got {value!r}") from None
    if not np.isfinite(columns).all():
        raise ValueError(f"{expected} finite numbers, got {tuple(values)!r}")
    return columns


def start_paths(task: Task, start: Start, count: int) -> Array:
    """Return the paths of a start, an array with y [m] of each point.

    If all environments share a path, the shape is (PATH_POINTS,). Otherwise the shape is
    (count, PATH_POINTS). Raise a ValueError if the start has no path or a path of another shape.
    """
    path = start.path
    if path is None or path.shape not in ((st.PATH_POINTS,), (count, st.PATH_POINTS)):
        raise ValueError(
            f"{type(task).__name__}.start must give a path of {st.PATH_POINTS} points, "
            f"got {None if path is None else path.shape}"
        )
    return path


def each_parcel(parcel: Parcel | Parcels, count: int) -> Parcels:
    """Return the parcels of `count` starts. If `parcel` is a single parcel, all starts have it."""
    if isinstance(parcel, Parcels):
        return parcel
    return Parcels((parcel,), np.zeros(count, dtype=np.int64))


# Number of starts drawn at a time, if nothing else uses the environment's generator.
MOST_AHEAD = 64
MOST_KEPT = 65536  # maximum number of starts over all environments


class ResetCache:
    """Random numbers for the next starts, drawn ahead by each environment's own generator."""

    def __init__(self, num_envs: int, draws: int, shared: bool, most_kept: int = MOST_KEPT) -> None:
        ahead = 1 if shared else min(MOST_AHEAD, max(1, most_kept // num_envs))
        self.generators: list[np.random.Generator | None] = [None] * num_envs
        self._numbers = np.zeros((num_envs, ahead, draws))
        self._used = np.full(num_envs, ahead)
        self._ahead = ahead
        self._rows: StartRows | None = None  # starts of all environments, one after another
        # whether an environment's starts are up to date
        self._laid = np.zeros(num_envs, dtype=np.bool_)

    def seed(self, i: int, generator: np.random.Generator) -> None:
        """Set the generator of environment `i`. If `generator` is already set, do nothing."""
        if self.generators[i] is not generator:
            self.generators[i] = generator
            self._used[i] = self._ahead

    def take(self, chosen: Integers) -> Array:
        """Return the next numbers (count, draws) of the chosen environments (count,)."""
        return self._numbers[chosen, self._next(chosen)]

    def taken(self, chosen: Integers) -> Array:
        """Return the numbers (count, draws) of the last start of each chosen environment."""
        return self._numbers[chosen, self._used[chosen] - 1]

    def take_rows(self, chosen: Integers, lay_out: Callable[[Array], StartRows]) -> StartRows:
        """Return the next start of each seeded environment in `chosen` (count,).

        `lay_out` makes starts from random numbers (starts, draws).
        """
        used = self._next(chosen)
        stale = chosen[~self._laid[chosen]]
        if len(stale) > 0:
            places = (stale[:, np.newaxis] * self._ahead + np.arange(self._ahead)).ravel()
            rows = lay_out(self._numbers[stale].reshape(len(places), -1))
            if self._rows is None:
                starts = self._laid.size * self._ahead
                self._rows = StartRows._make(
                    np.zeros((starts, *values.shape[1:]), dtype=values.dtype) for values in rows
                )
            for kept, values in zip(self._rows, rows, strict=True):
                kept[places] = values
            self._laid[stale] = True
        assert self._rows is not None
        here = chosen * self._ahead + used
        return StartRows._make(values[here] for values in self._rows)

    def _next(self, chosen: Integers) -> Integers:
        """Use up a start of each environment in `chosen` (count,); return the starts' indices."""
        used = self._used[chosen]
        if used.max(initial=0) == self._ahead:
            for i in chosen[used == self._ahead].tolist():
                generator = self.generators[i]
                assert generator is not None
                self._numbers[i] = generator.random(self._numbers.shape[1:])
                self._used[i] = 0
                self._laid[i] = False
            used = self._used[chosen]
        self._used[chosen] += 1
        return used
