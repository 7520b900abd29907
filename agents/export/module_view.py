"""What a module sees, as formulas of the observation: `agents.modules.view`, which is reckoned with
arrays, said once more for a graph and for C. An export is refused where the two differ.
"""

import math
from dataclasses import dataclass

import numpy as np

from surface_gym.core.actions import GROUPS, QUADRANT_SIZE
from surface_gym.lines import Line
from surface_gym.settings import Settings

from ..mirror import SIDE
from ..modules.outline import ELLIPSE, EXACT, ROUND
from ..modules.view import MARGIN
from .formula import Formula, angle_of, constant, feature, hypotenuse, limited, of_module, operation

_LEAST_COSINE = math.cos(0.5 * math.pi)  # [-] of an angle as near to a right one as doubles come

Pair = tuple[Formula, Formula]  # along and across


@dataclass(frozen=True, eq=False)
class SeenByModule:
    """Formulas of what each module sees."""

    place: tuple[Formula, ...]  # numbers that it sees of itself
    bears: Formula  # whether it bears the parcel, or will by the next decision
    mirrored: Formula  # whether the asked side is y < 0


@dataclass(frozen=True, eq=False)
class _Outline:
    half: Pair  # [m]
    roundness: Formula | None  # [-] 0: a rectangle, 1: an ellipse; None: always a rectangle
    rows: Formula  # of the line it runs on


def _magnitude(value: Formula) -> Formula:
    return operation("absolute", value)


def _number(truth: Formula) -> Formula:
    return operation("choose", truth, 1.0, 0.0)


def seen_by_module(settings: Settings) -> SeenByModule:
    """For the modules of an action, in its order."""
    sight = _Sight(settings)
    x, y, row = sight.from_centre()
    (cosine, sine), (cosine_later, sine_later) = sight.turns()
    period = settings.control_period
    now = _from_parcel(x, y, cosine, sine)
    later = _from_parcel(x - period * sight.vx, y - period * sight.vy, cosine_later, sine_later)
    half = sight.outline.half
    outside, outside_later = (_outside(sight.outline, place) for place in (now, later))
    place = (
        now[0] / half[0], now[1] / half[1], later[0] / half[0], later[1] / half[1],
        _number(operation("at most", outside, 0.0)),
        _number(operation("at most", outside_later, 0.0)),
        x / 0.3, y / 0.3, (y + sight.offset) / 0.15,
        *sight.axes_around(x, y),
    )  # fmt: skip
    moved = period * (_magnitude(sight.vx) + _magnitude(sight.vy))
    close = (hypotenuse(*half) + moved + 2.0 * MARGIN).named("close")
    pitch = settings.chosen_plant.pitch_y
    bears = operation("at most", operation("minimum", outside, outside_later), MARGIN)
    for less, more in (
        (_magnitude(row), 0.5 * pitch * sight.outline.rows),
        (_magnitude(x), close),
        (_magnitude(y), close),
    ):
        bears = operation("both", bears, operation("below", less, more))
    return SeenByModule(place, bears, sight.mirrored)


class _Sight:
    """The parcel as the observation shows it, the goal at y > 0."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._columns = {each.name: k for k, each in enumerate(settings.features)}
        self.mirrored = operation("below", feature(SIDE), 0.0)
        self.offset = (0.3 * self._shown("lateral offset")).named("offset")
        self.vx = (1.0 + self._shown("forward speed")).named("vx")
        self.vy = (0.5 * self._shown("lateral speed")).named("vy")
        sine, cosine = self._shown("sine of theta"), self._shown("cosine of theta")
        long = hypotenuse(sine, cosine)
        turned = operation("below", 0.0, long)
        self._cosine = operation("choose", turned, cosine / long, 1.0).named("cosine")
        self._sine = operation("choose", turned, sine / long, 0.0).named("sine")
        shown = "parcel" in settings.observe
        self.outline = self._outline_shown() if shown else self._outline_by_clearance()
        into_zone = 0.5 * self._shown("distance into zone") + self._reach()
        self._into_zone = (self._in_phase(into_zone) if shown else into_zone).named("into_zone")

    def _shown(self, name: str) -> Formula:
        return feature(self._columns[name])

    def turns(self) -> tuple[Pair, Pair]:
        """Cosine and sine of theta, at present and after a period."""
        turn = self._settings.control_period * 3.0 * self._shown("turning speed")
        c, s = operation("cosine", turn), operation("sine", turn)
        later = (self._cosine * c - self._sine * s, self._sine * c + self._cosine * s)
        return (self._cosine, self._sine), later

    def from_centre(self) -> tuple[Formula, Formula, Formula]:
        """[m] x and y of each module from the parcel's centre, and y from the line's middle."""
        kind, plant = self._settings.action_kind, self._settings.chosen_plant
        row, column = np.divmod(np.arange(kind.size), kind.columns)
        x = of_module("x", plant.pitch_x * (column + 0.5))
        y = of_module("y", plant.pitch_y * (row - (kind.rows - 1) / 2.0))
        mirror = operation("choose", self.mirrored, -1.0, 1.0)
        return x - self._into_zone, mirror * y - self.offset, y

    def axes_around(self, x: Formula, y: Formula) -> tuple[Formula, ...]:
        """What is shown of the rotors in a module's quadrant; nothing where none is."""
        if "rotors" not in self._settings.observe:
            return ()
        names = [each.name for each in GROUPS["rotors"].features]
        behind, right = operation("below", x, 0.0), operation("below", y, 0.0)
        ahead_left, ahead_right, behind_left, behind_right = (
            [self._shown(name) for name in names[first : first + QUADRANT_SIZE]]
            for first in range(0, len(names), QUADRANT_SIZE)
        )
        return tuple(
            operation(
                "choose", behind,
                operation("choose", right, behind_right[k], behind_left[k]),
                operation("choose", right, ahead_right[k], ahead_left[k]),
            )
            for k in range(QUADRANT_SIZE)
        )  # fmt: skip

    def _outline_shown(self) -> _Outline:
        half = tuple(0.175 + 0.05 * self._shown(name) for name in ("length", "width"))
        empty = (constant(1.0) - self._shown("fill")) / (1.0 - ELLIPSE)
        pairs = half[1] / self._settings.chosen_plant.pitch_y + EXACT
        return _Outline(
            (half[0].named("half_length"), half[1].named("half_width")),
            limited(empty, 0.0, 1.0).named("roundness"),
            self._rows(pairs),
        )

    def _outline_by_clearance(self) -> _Outline:
        pitch = self._settings.chosen_plant.pitch_y
        length = (0.175 + 0.05 * self._shown("size")).named("half_length")
        cosine, sine = _magnitude(self._cosine), _magnitude(self._sine)
        beyond = self.offset - 0.2 * self._shown("clearance")
        across = beyond - length * sine
        rows = self._rows((across / pitch + (1.5 - ROUND)) / (1.0 + cosine))
        half_line = 0.5 * pitch * (rows - 1.0)
        reach = across - half_line
        as_wide = operation("below", _magnitude(reach - length * cosine), EXACT)
        is_disc = operation("below", _magnitude(beyond - half_line - length), EXACT)
        told = reach / operation("maximum", cosine, _LEAST_COSINE)
        width = operation(
            "choose",
            operation("either", as_wide, is_disc),
            length,
            limited(told, 0.5 * length, 2.0 * length),
        )
        return _Outline((length, width.named("half_width")), None, rows)

    def _rows(self, pairs: Formula) -> Formula:
        plant = self._settings.chosen_plant
        least = 2.0 if isinstance(plant, Line) else float(plant.zone_rows)
        return limited(2.0 * operation("floor", pairs), least, plant.zone_rows).named("rows")

    def _reach(self) -> Formula:
        """[m] along x from the centre."""
        length, width = self.outline.half
        cosine, sine = _magnitude(self._cosine), _magnitude(self._sine)
        straight = length * cosine + width * sine
        if self.outline.roundness is None:
            return straight
        bent = hypotenuse(length * cosine, width * sine)
        return straight + self.outline.roundness * (bent - straight)

    def _in_phase(self, into_zone: Formula) -> Formula:
        """The nearest place whose phase within a pitch is the one that is shown."""
        pitch = self._settings.chosen_plant.pitch_x
        phase = angle_of(self._shown("sine of phase x"), self._shown("cosine of phase x"))
        in_pitch = 0.5 + phase / (2.0 * math.pi)
        return pitch * (operation("round", into_zone / pitch - in_pitch) + in_pitch)


def _outside(outline: _Outline, place: Pair) -> Formula:
    """[m] how far a place is beyond the base; negative under it."""
    (along, across), (length, width) = place, outline.half
    straight = operation("maximum", _magnitude(along) - length, _magnitude(across) - width)
    if outline.roundness is None:
        return straight
    least = operation("minimum", length, width)
    bent = (hypotenuse(along / length, across / width) - 1.0) * least
    return straight + outline.roundness * (bent - straight)


def _from_parcel(x: Formula, y: Formula, cosine: Formula, sine: Formula) -> Pair:
    """[m] along and across the parcel's own axes."""
    return (cosine * x + sine * y).named("along"), (cosine * y - sine * x).named("across")
