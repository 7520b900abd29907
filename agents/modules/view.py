"""What each module that matters sees: its own place under the parcel, beside what all see."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.core.actions import GROUPS, QUADRANT_SIZE, QUADRANTS, group_features
from surface_gym.settings import Settings
from surface_gym.tasks.sort import FEATURES

from ..mirror import SIDE, mirrored_orientations
from ..sight import LineSight, line_sight
from .outline import Numbers, Outline, outline_by_clearance, outline_shown

Singles = NDArray[np.float32]
Integers = NDArray[np.int64]

_NAMES = tuple(feature.name for feature in FEATURES)
# The side is seen as a mirror image. The time would tie what is learned to one length of lead-in.
_SHARED = tuple(k for k, name in enumerate(_NAMES) if name not in ("side", "time"))
_ROTORS = {feature.name for feature in GROUPS["rotors"].features}
_PLACE_SIZE = 9  # numbers that say where a module is
MARGIN = 0.01  # [m] a module this near to the base may bear it


def shared_size(observe: tuple[str, ...]) -> int:
    """Numbers that all modules of a lane see alike, where the observation shows some groups."""
    return len(_SHARED) + len(group_features(observe))


def place_size(observe: tuple[str, ...]) -> int:
    """Numbers that a module sees of itself, where the observation shows some groups."""
    return _PLACE_SIZE + (QUADRANT_SIZE if "rotors" in observe else 0)


@dataclass(frozen=True, eq=False)
class Seen:
    """What the modules of some lanes see, the goal at y > 0; modules in the order of lanes."""

    shared: Singles  # (lanes, shared) what all modules of a lane see alike
    lane: Integers  # (modules,) whose parcel the module bears, or will by the next decision
    # (modules, place) where the module is: under the parcel and beside it; then the axes around it
    place: Singles
    number: Integers  # (modules,) its place in the action


class ModuleView:
    """Turns observations of Sort into what modules see, and their choices into actions.

    Where the observation shows the group "parcel", a base is as long, as wide and as round as it
    says; else it is taken for a rectangle, as wide as the clearance tells. Where it shows "rotors",
    a module sees the axes of its own quadrant of the parcel.

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
        self._plant = settings.chosen_plant
        # [m] from the zone's first edge, and from the line's middle.
        self._column = self._plant.pitch_x * (np.arange(kind.columns) + 0.5)
        self._row = self._plant.pitch_y * (np.arange(kind.rows) - (kind.rows - 1) / 2.0)
        self._image = mirrored_orientations(settings.chosen_orientations)
        angles = np.array(settings.chosen_orientations)
        self._rest = int(np.abs(np.sin(angles)).argmax())  # the choice nearest to 90 deg
        columns = {feature.name: k for k, feature in enumerate(settings.features)}
        of_groups = [columns[feature.name] for feature in group_features(settings.observe)]
        self._shared = np.array([*_SHARED, *of_groups])
        self._columns = columns
        self._lie = self._lie_shown if "parcel" in settings.observe else self._lie_by_clearance
        # (QUADRANTS, QUADRANT_SIZE) columns of what each shows; (QUADRANTS, 0) where none does.
        rotors = [name for name in columns if name in _ROTORS]
        self._rotors = np.array([columns[name] for name in rotors], dtype=np.int64)
        self._rotors = self._rotors.reshape(len(QUADRANTS), -1)

    def __call__(self, observations: Singles) -> Seen:
        """What is seen in observations (lanes, features)."""
        see = _to_the_left(line_sight(self._settings, observations))
        outlines, into_zone = self._lie(see, observations)
        lane, number, x, y = self._near(see, outlines, into_zone)
        outline = outlines.of(lane)
        period = self._settings.control_period
        now = _from_parcel(x, y, see.theta[lane])
        later = _from_parcel(
            x - period * see.vx[lane],
            y - period * see.vy[lane],
            (see.theta + period * see.omega)[lane],
        )
        outside = np.stack([outline.outside(now), outline.outside(later)])
        beside = np.stack([x / 0.3, y / 0.3, (y + see.offset[lane]) / 0.15])
        parts = (now / outline.half, later / outline.half, outside <= 0.0, beside)
        place = np.concatenate([*parts, self._axes(observations, lane, x, y)]).T
        bears = outside.min(axis=0) <= MARGIN
        return Seen(
            observations[:, self._shared],
            lane[bears],
            place[bears].astype(np.float32),
            number[bears],
        )

    def _lie_by_clearance(self, see: LineSight, observations: Singles) -> tuple[Outline, Numbers]:
        """Outlines, and x of the bases' centres past the zone's first edge (lanes,) [m]."""
        clearance = 0.2 * observations[:, self._columns["clearance"]].astype(np.float64)
        outline = outline_by_clearance(see, clearance, self._plant)
        return outline, see.into_zone + (outline.reach(see.theta) - see.reach)

    def _lie_shown(self, see: LineSight, observations: Singles) -> tuple[Outline, Numbers]:
        """The same where the outline is shown: x is exact, as its place in a pitch is known."""
        names = ("length", "width", "fill", "sine of phase x", "cosine of phase x")
        length, width, fill, sine, cosine = (
            observations[:, self._columns[name]].astype(np.float64) for name in names
        )
        outline = outline_shown(length, width, fill, self._plant)
        pitch = self._plant.pitch_x
        into_zone = see.into_zone + (outline.reach(see.theta) - see.reach)
        in_pitch = 0.5 + np.arctan2(sine, cosine) / (2.0 * np.pi)  # from a column's first edge
        return outline, pitch * (np.round(into_zone / pitch - in_pitch) + in_pitch)

    def _axes(self, observations: Singles, lane: Integers, x: Numbers, y: Numbers) -> Singles:
        """(shown, modules) of the rotors in the quadrant of each module, at x and y [m] from the
        parcel's centre.
        """
        quadrant = 2 * (x < 0.0) + (y < 0.0)
        return observations[lane[:, np.newaxis], self._rotors[quadrant]].T

    def _near(
        self, see: LineSight, outline: Outline, into_zone: Numbers
    ) -> tuple[Integers, Integers, Numbers, Numbers]:
        """Modules that the parcel may reach in a period: lane, place in the action, and x and y
        [m] from its centre.
        """
        mirror = np.where(see.side < 0.0, -1.0, 1.0)[:, np.newaxis]
        row = mirror * self._row
        x = self._column - into_zone[:, np.newaxis]
        y = row - see.offset[:, np.newaxis]
        moved = self._settings.control_period * (np.abs(see.vx) + np.abs(see.vy))
        close = (np.hypot(*outline.half) + moved + 2.0 * MARGIN)[:, np.newaxis]
        # Only the line's rotors bear.
        line = np.abs(row) < 0.5 * self._plant.pitch_y * outline.rows[:, np.newaxis]
        rows = line & (np.abs(y) < close)
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
