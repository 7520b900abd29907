"""The decision of modules that share weights, for a graph.

`agents.module_view` computes what a module sees with arrays whose size depends on the observation.
A graph needs it for all modules at once, so that it is written here once more, for NumPy and for a
graph alike. An export is refused where the two differ.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.core.actions import GROUPS, QUADRANT_SIZE
from surface_gym.lines import Line

from ..module_view import ELLIPSE, EXACT, MARGIN, ROUND
from ..symmetry import SIDE, mirrored_orientations
from .onnx_graph import OBSERVATION, Graph
from .policy import Integers, Layer, Network, Singles, Source, are_close, to_array

EDGE = 1e-9  # numbers of moderate size that differ by less are the same but for round-off
_LEAST_COSINE = math.cos(0.5 * math.pi)  # [-] of an angle as near to a right one as doubles come
_COMPARISONS = (np.less, np.less_equal, np.greater, np.greater_equal)
_APART = ("side", "time")  # features that modules do not see


@dataclass(frozen=True, eq=False)
class SeenByModules:
    """Arrays (parcels, modules), or (parcels, 1), traced or computed."""

    place: tuple[Any, ...]  # numbers that a module sees of itself
    bears: Any  # whether it bears the parcel, or will by the next decision
    mirrored: Any  # whether the asked side is y < 0


def seen_by_modules(settings: EnvConfig, features: Sequence[Any]) -> SeenByModules:
    """Compute what each module sees, in the action's order.

    Args:
        settings: of the environment.
        features: of the observation, each (parcels, 1).
    """
    see = {each.name: feature for each, feature in zip(settings.features, features, strict=True)}
    kind, plant, period = settings.action_kind, settings.chosen_line, settings.control_period
    mirrored = features[SIDE] < 0.0
    offset = 0.3 * see["lateral offset"]
    vx, vy = 1.0 + see["forward speed"], 0.5 * see["lateral speed"]
    sine, cosine = see["sine of theta"], see["cosine of theta"]
    length = _hypot(sine, cosine)
    turned = length > 0.0
    cosine, sine = np.where(turned, cosine / length, 1.0), np.where(turned, sine / length, 0.0)
    outline, into_zone = _lie(settings, see, offset, (cosine, sine))
    turn = period * 3.0 * see["turning speed"]
    c, s = np.cos(turn), np.sin(turn)
    later_axes = (cosine * c - sine * s, sine * c + cosine * s)
    row, column = np.divmod(np.arange(kind.size), kind.columns)
    line_y = plant.pitch_y * (row - (kind.rows - 1) / 2.0)[np.newaxis]
    x = plant.pitch_x * (column + 0.5)[np.newaxis] - into_zone
    y = np.where(mirrored, -1.0, 1.0) * line_y - offset
    now = _from_parcel(x, y, (cosine, sine))
    later = _from_parcel(x - period * vx, y - period * vy, later_axes)
    outside, outside_later = outline.outside(now), outline.outside(later)
    place = (
        now[0] / outline.half[0], now[1] / outline.half[1],
        later[0] / outline.half[0], later[1] / outline.half[1],
        np.where(outside <= 0.0, 1.0, 0.0), np.where(outside_later <= 0.0, 1.0, 0.0),
        x / 0.3, y / 0.3, (y + offset) / 0.15,
        *_axes_around(settings, see, x, y),
    )  # fmt: skip
    close = _hypot(*outline.half) + period * (abs(vx) + abs(vy)) + 2.0 * MARGIN
    bears = (
        (np.minimum(outside, outside_later) <= MARGIN)
        & (np.absolute(line_y) < 0.5 * plant.pitch_y * outline.rows)
        & (abs(x) < close)
        & (abs(y) < close)
    )
    return SeenByModules(place, bears, mirrored)


@dataclass(frozen=True, eq=False)
class _Outline:
    half: tuple[Any, Any]  # [m] of its length and width
    roundness: Any  # [-] 0: a rectangle, 1: an ellipse; None: always a rectangle
    rows: Any  # of the line it runs on

    def reach(self, cosine: Any, sine: Any) -> Any:
        """[m] that the base reaches along x."""
        (length, width), cosine, sine = self.half, abs(cosine), abs(sine)
        straight = length * cosine + width * sine
        if self.roundness is None:
            return straight
        return straight + self.roundness * (_hypot(length * cosine, width * sine) - straight)

    def outside(self, place: tuple[Any, Any]) -> Any:
        """[m] from the base to a place; negative under it."""
        (along, across), (length, width) = place, self.half
        straight = np.maximum(abs(along) - length, abs(across) - width)
        if self.roundness is None:
            return straight
        bent = (_hypot(along / length, across / width) - 1.0) * np.minimum(length, width)
        return straight + self.roundness * (bent - straight)


def _lie(
    settings: EnvConfig, see: dict[str, Any], offset: Any, axes: tuple[Any, Any]
) -> tuple[_Outline, Any]:
    """Outline of the base, and [m] from the zone's first edge to its centre."""
    plant = settings.chosen_line
    least = 2.0 if isinstance(plant, Line) else float(plant.zone_rows)

    def rows(pairs: Any) -> Any:
        return _clip(2.0 * np.floor(pairs), least, float(plant.zone_rows))

    cosine, sine = abs(axes[0]), abs(axes[1])
    if "parcel" in settings.observe:
        length, width = (0.175 + 0.05 * see[name] for name in ("length", "width"))
        roundness = _clip((1.0 - see["fill"]) / (1.0 - ELLIPSE), 0.0, 1.0)
        outline = _Outline((length, width), roundness, rows(width / plant.pitch_y + EXACT))
        into_zone = 0.5 * see["distance into zone"] + outline.reach(*axes)
        # The nearest place whose phase within a pitch is the one that is shown.
        phase = _angle(see["sine of phase x"], see["cosine of phase x"])
        in_pitch = 0.5 + phase / (2.0 * math.pi)
        pitch = plant.pitch_x
        return outline, pitch * (np.rint(into_zone / pitch - in_pitch) + in_pitch)
    length = 0.175 + 0.05 * see["size"]
    beyond = offset - 0.2 * see["clearance"]
    across = beyond - length * sine
    count = rows((across / plant.pitch_y + (1.5 - ROUND)) / (1.0 + cosine))
    half_line = 0.5 * plant.pitch_y * (count - 1.0)
    reach = across - half_line
    as_wide = abs(reach - length * cosine) < EXACT
    is_disc = abs(beyond - half_line - length) < EXACT
    width = _clip(reach / np.maximum(cosine, _LEAST_COSINE), 0.5 * length, 2.0 * length)
    outline = _Outline((length, np.where(as_wide | is_disc, length, width)), None, count)
    return outline, 0.5 * see["distance into zone"] + outline.reach(*axes)


def _axes_around(settings: EnvConfig, see: dict[str, Any], x: Any, y: Any) -> tuple[Any, ...]:
    """Return what is shown of the rotors in a module's quadrant; nothing if none is."""
    if "rotors" not in settings.observe:
        return ()
    shown = [see[each.name] for each in GROUPS["rotors"].features]
    behind, right, size = x < 0.0, y < 0.0, QUADRANT_SIZE
    return tuple(
        np.where(
            behind,
            np.where(right, shown[3 * size + k], shown[2 * size + k]),
            np.where(right, shown[size + k], shown[k]),
        )
        for k in range(size)
    )


def _from_parcel(x: Any, y: Any, axes: tuple[Any, Any]) -> tuple[Any, Any]:
    """[m] along and across the parcel's own axes."""
    cosine, sine = axes
    return cosine * x + sine * y, cosine * y - sine * x


def _hypot(one: Any, other: Any) -> Any:
    return np.sqrt(one * one + other * other)


def _clip(value: Any, low: Any, high: Any) -> Any:
    return np.minimum(np.maximum(value, low), high)


def _angle(sine: Any, cosine: Any) -> Any:
    """[rad] in [-pi, pi], as `arctan2`."""
    length = _hypot(sine, cosine)
    straight = np.where(cosine < 0.0, math.pi, 0.0)
    level = (sine <= 0.0) & (sine >= 0.0)
    behind = np.where(level, straight, 2.0 * np.arctan((length - cosine) / sine))
    rough = np.where(cosine > 0.0, 2.0 * np.arctan(sine / (length + cosine)), behind)
    # A graph's arc tangent is of single precision: what is left of the angle, by its sine.
    left = (sine * np.cos(rough) - cosine * np.sin(rough)) / length
    return np.where(length > 0.0, rough + left, 0.0)


class Watched(NDArrayOperatorsMixin):
    """An array that notes where round-off may change the outcome of a comparison or a jump.

    Args:
        value: of each element.
        doubts: list that takes an array of booleans for each comparison and jump.
        exact: whether the value is given, and has no round-off.
    """

    def __init__(self, value: Any, doubts: list[Any], exact: bool = False) -> None:
        self.value, self.doubts, self.exact = value, doubts, exact

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options:
            return NotImplemented
        values = [each.value if isinstance(each, Watched) else each for each in inputs]
        rounded = any(isinstance(each, Watched) and not each.exact for each in inputs)
        if function in _COMPARISONS and rounded:
            self.doubts.append(np.abs(values[0] - values[1]) <= EDGE)
        elif function in (np.floor, np.rint):
            steps = values[0] - (0.5 if function is np.rint else 0.0)
            self.doubts.append(np.abs(steps - np.round(steps)) <= EDGE)
        return Watched(function(*values), self.doubts)

    def __array_function__(self, function: Any, kinds: Any, inputs: Any, options: Any) -> Any:
        if function is not np.where:
            return NotImplemented
        values = [each.value if isinstance(each, Watched) else each for each in inputs]
        return Watched(np.where(*values), self.doubts)


@dataclass(frozen=True, eq=False)
class ModulesDecision:
    """The decision of modules: each that bears the parcel chooses by one shared network."""

    network: Network
    settings: EnvConfig  # of the environment
    shared: Integers  # (shared,) indices of the features that all modules see
    images: Integers  # (choices,) the mirror image of each orientation
    rest: int  # choice of the other modules
    angles: tuple[float, ...]  # [rad] of the orientations on offer

    @property
    def features(self) -> int:
        """Size of an observation."""
        return len(self.settings.features)

    @property
    def parts(self) -> int:
        """Size of an action."""
        return self.settings.action_kind.size

    def in_doubt(self, observations: Singles, tie: float) -> NDArray[np.bool_]:
        """Tell for each module whether round-off may decide either way; see `NetworkDecision`."""
        doubts: list[Any] = []
        columns = observations.astype(np.float64).T[..., np.newaxis]
        with np.errstate(divide="ignore", invalid="ignore"):  # of what is not chosen
            seen = seen_by_modules(
                self.settings, [Watched(column, doubts, exact=True) for column in columns]
            )
        shape = (len(observations), self.parts)
        place = np.stack([np.broadcast_to(each.value, shape) for each in seen.place], axis=2)
        alike = np.repeat(observations[:, np.newaxis, self.shared], self.parts, axis=1)
        inputs = np.concatenate([alike, place.astype(np.float32)], axis=2)
        bears = np.broadcast_to(seen.bears.value, shape)
        close = np.zeros(shape, dtype=np.bool_)
        close[bears] = are_close(self.network.scores(inputs[bears].astype(np.float64)), tie)
        for doubt in doubts:
            close |= doubt
        return close


def add_modules_decision(graph: Graph, decision: ModulesDecision) -> str:
    """Add the decision of modules; returns the name of the choices (parcels, parts)."""
    seen = seen_by_modules(decision.settings, graph.features(decision.features))
    last = graph.integers(2)
    place = [graph.add("Unsqueeze", each.name, last) for each in seen.place]
    alike = graph.add("Gather", OBSERVATION, graph.array(decision.shared), axis=1)
    one = graph.add("Unsqueeze", alike, graph.integers(1))
    each = graph.add("Expand", one, graph.integers(1, decision.parts, 1))
    own = graph.cast(graph.add("Concat", *place, axis=2), "FLOAT")
    inputs = graph.add("Concat", each, own, axis=2)
    scores = graph.network(decision.network, inputs)
    best = graph.add("ArgMax", scores, axis=2, keepdims=0)
    image = graph.add("Gather", graph.array(decision.images), best)
    turned = graph.add("Where", seen.mirrored.name, image, best)
    return graph.add("Where", seen.bears.name, turned, graph.array(np.array(decision.rest)))


def modules_decision(source: Source) -> ModulesDecision:
    """Return the decision of modules that share weights, for the zone they were trained on."""
    settings = source.settings
    angles = settings.chosen_orientations
    names = [each.name for each in settings.features]
    arrays = {name: to_array(values) for name, values in source.weights.items()}
    # The weights of what all see and of what each sees, side by side.
    first = np.concatenate([arrays["_alike.weight"], arrays["_apart.weight"]], axis=1)
    between = sorted({int(name.split(".")[1]) for name in arrays if name.startswith("_between.")})
    later = [f"_between.{k}" for k in between] + ["_logits"]
    layers = [Layer(arrays[f"{name}.weight"], arrays[f"{name}.bias"]) for name in later]
    return ModulesDecision(
        Network((Layer(first, arrays["_alike.bias"]), *layers), "tanh"),
        settings,
        np.array([k for k, name in enumerate(names) if name not in _APART], dtype=np.int64),
        mirrored_orientations(angles),
        int(np.abs(np.sin(angles)).argmax()),
        angles,
    )
