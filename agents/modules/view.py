"""What each module that matters sees: its own place under the parcel, beside what all see."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.settings import Settings
from surface_gym.tasks.sort import FEATURES

from ..mirror import SIDE, mirrored_orientations
from ..sight import LineSight, line_sight

Numbers = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]

_NAMES = tuple(feature.name for feature in FEATURES)
# The side is seen as a mirror image. The time would tie what is learned to one length of lead-in.
SHARED = tuple(k for k, name in enumerate(_NAMES) if name not in ("side", "time"))
CLEARANCE = _NAMES.index("clearance")
PLACE_SIZE = 9  # numbers that say where a module is
MARGIN = 0.01  # [m] a module this near to the base may bear it


@dataclass(frozen=True, eq=False)
class Seen:
    """What the modules of some lanes see, the goal at y > 0; modules in the order of lanes."""

    shared: Singles  # (lanes, shared) what all modules of a lane see alike
    lane: Integers  # (modules,) whose parcel the module bears, or will by the next decision
    place: Singles  # (modules, PLACE_SIZE) where the module is: under the parcel and beside it
    number: Integers  # (modules,) its place in the action


class ModuleView:
    """Turns observations of Sort into what modules see, and their choices into actions.

    Args:
        settings: of the environment, of whatever zone.

    Raises:
        ValueError: the settings are of another task or kind of action, or lack a mirror image of
            an orientation.
    """

    def __init__(self, settings: Settings) -> None:
        checks.one_of("task", settings.task_name, ("sort",))
        checks.one_of("actions", settings.actions, ("modules",))
        self._settings = settings
        kind = settings.action_kind
        self._size = kind.size
        plant = settings.chosen_plant
        self._pitch_y = plant.pitch_y
        # [m] from the zone's first edge, and from the line's middle.
        self._column = plant.pitch_x * (np.arange(kind.columns) + 0.5)
        self._row = plant.pitch_y * (np.arange(kind.rows) - (kind.rows - 1) / 2.0)
        self._image = mirrored_orientations(settings.chosen_orientations)
        angles = np.array(settings.chosen_orientations)
        self._rest = int(np.abs(np.sin(angles)).argmax())  # the choice nearest to 90 deg

    def __call__(self, observations: Singles) -> Seen:
        """What is seen in observations (lanes, features)."""
        see = _to_the_left(line_sight(self._settings, observations))
        # Only the line's rotors bear: the clearance tells how many rows there are.
        half_line = see.offset - see.reach - 0.2 * observations[:, CLEARANCE]
        lane, number, x, y = self._near(see, half_line)
        half = see.half_length[lane]
        period = self._settings.control_period
        now = _from_parcel(x, y, see.theta[lane])
        later = _from_parcel(
            x - period * see.vx[lane],
            y - period * see.vy[lane],
            (see.theta + period * see.omega)[lane],
        )
        outside = np.stack([np.abs(now).max(axis=0), np.abs(later).max(axis=0)]) - half
        beside = np.stack([x / 0.3, y / 0.3, (y + see.offset[lane]) / 0.15])
        place = np.concatenate([now / half, later / half, outside <= 0.0, beside]).T
        bears = outside.min(axis=0) <= MARGIN
        return Seen(
            observations[:, SHARED],
            lane[bears],
            place[bears].astype(np.float32),
            number[bears],
        )

    def _near(
        self, see: LineSight, half_line: Numbers
    ) -> tuple[Integers, Integers, Numbers, Numbers]:
        """Modules that the parcel may reach in a period: lane, place in the action, and x and y
        [m] from its centre; `half_line` [m] is from the line's middle to its outermost rotors.
        """
        mirror = np.where(see.side < 0.0, -1.0, 1.0)[:, np.newaxis]
        row = mirror * self._row
        x = self._column - see.into_zone[:, np.newaxis]
        y = row - see.offset[:, np.newaxis]
        moved = self._settings.control_period * (np.abs(see.vx) + np.abs(see.vy))
        close = (math.sqrt(2.0) * see.half_length + moved + 2.0 * MARGIN)[:, np.newaxis]
        rows = (np.abs(row) <= half_line[:, np.newaxis] + self._pitch_y / 4.0) & (np.abs(y) < close)
        columns = np.abs(x) < close
        lane, place, column = np.nonzero(rows[:, :, np.newaxis] & columns[:, np.newaxis, :])
        number = place * len(self._column) + column
        return lane, number, x[lane, column], y[lane, place]

    def actions(self, observations: Singles, seen: Seen, choices: Integers) -> Integers:
        """Actions (lanes, size) of the modules' choices (modules,); the others stay at 90 deg."""
        actions = np.full((len(observations), self._size), self._rest)
        mirrored = observations[seen.lane, SIDE] < 0.0
        actions[seen.lane, seen.number] = np.where(mirrored, self._image[choices], choices)
        return actions


def _to_the_left(see: LineSight) -> LineSight:
    """The mirror image where the parcel is to go to y < 0."""
    mirror = np.where(see.side < 0.0, -1.0, 1.0)
    return replace(
        see,
        offset=mirror * see.offset,
        theta=mirror * see.theta,
        vy=mirror * see.vy,
        omega=mirror * see.omega,
    )


def _from_parcel(x: Numbers, y: Numbers, theta: Numbers) -> Numbers:
    """(2, modules) [m] along and across the parcel's own axes."""
    cosine, sine = np.cos(theta), np.sin(theta)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x])
