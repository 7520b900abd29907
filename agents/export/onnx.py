"""Policies as ONNX graphs.

A graph computes the views of all modules at once. `agents.module_policy` selects modules by the
observation, so it cannot be exported. This file repeats its computation for NumPy and for graphs.
An export fails if the two differ.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.feature_groups import GROUPS, QUADRANT_SIZE
from surface_gym.lines import Line
from surface_gym.tasks.features import decode

from ..base import SIDE, Integers, Singles
from ..module_places import ACROSS, BESIDE, ELLIPSE, EXACT, MARGIN, ROUND
from .policy import Layer, Network, NetworkDecision, Source, are_close, to_array

OPSET = 17  # version of ONNX's operators
IR_VERSION = 8  # version of the file format for this OPSET
OBSERVATION, CHOICES, ANGLES = "observation", "choices", "angles"
_ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu"}
_OPERATORS: dict[Any, str] = {
    np.add: "Add", np.subtract: "Sub", np.multiply: "Mul", np.divide: "Div", np.sqrt: "Sqrt",
    np.maximum: "Max", np.minimum: "Min", np.absolute: "Abs", np.rint: "Round", np.floor: "Floor",
    np.sin: "Sin", np.cos: "Cos", np.less: "Less", np.less_equal: "LessOrEqual",
    np.greater: "Greater", np.greater_equal: "GreaterOrEqual",
    np.bitwise_and: "And", np.bitwise_or: "Or",
}  # fmt: skip


def need(package: str) -> Any:
    """Import a library of the extra `export`."""
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"an export needs {error.name}, which is not installed: "
            "pip install 'surface_gym[agents,export]'"
        ) from None


class Graph:
    """Nodes and constants of an ONNX graph; methods add nodes and return the result's name."""

    def __init__(self) -> None:
        self._onnx = need("onnx")
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """Add a node with one output, named by the caller or by its index."""
        output = output or f"{kind.lower()} {len(self._nodes)}"
        made = self._onnx.helper.make_node(kind, list(inputs), [output], **attributes)
        self._nodes.append(made)
        return output

    def array(self, values: NDArray[Any]) -> str:
        name = f"constant {len(self._constants)}"
        self._constants.append(self._onnx.numpy_helper.from_array(np.asarray(values), name))
        return name

    def integers(self, *values: int) -> str:
        return self.array(np.array(values, dtype=np.int64))

    def cast(self, value: str, kind: str) -> str:
        return self.add("Cast", value, to=getattr(self._onnx.TensorProto, kind))

    def network(self, network: Network, values: str) -> str:
        """Compute scores (..., outputs) of values (..., inputs)."""
        for k, layer in enumerate(network.layers):
            if k:
                values = self.add(_ACTIVATIONS[network.activation], values)
            values = self.add("MatMul", values, self.array(layer.weights.T.copy()))
            values = self.add("Add", values, self.array(layer.bias))
        return values

    def features(self, count: int) -> list["GraphArray"]:
        """Return each feature of the observation, (parcels, 1) in double precision."""
        doubles = self.cast(OBSERVATION, "DOUBLE")
        gathered = (self.add("Gather", doubles, self.integers(k), axis=1) for k in range(count))
        return [GraphArray(self, name) for name in gathered]

    def model(
        self,
        shape: tuple[int, int],
        orientations: Sequence[float],
        choices: str,
        metadata: Mapping[str, str],
    ) -> bytes:
        """Return the checked model as the bytes of a file."""
        onnx = self._onnx
        self.add("Identity", choices, output=CHOICES)
        self.add("Gather", self.array(np.array(orientations)), choices, output=ANGLES)
        kinds, value = onnx.TensorProto, onnx.helper.make_tensor_value_info
        graph = onnx.helper.make_graph(
            self._nodes,
            "decide",
            [value(OBSERVATION, kinds.FLOAT, ["num_envs", shape[0]])],
            [
                value(CHOICES, kinds.INT64, ["num_envs", shape[1]]),
                value(ANGLES, kinds.DOUBLE, ["num_envs", shape[1]]),
            ],
            self._constants,
        )
        model = onnx.helper.make_model(
            graph,
            producer_name="surface_gym",
            opset_imports=[onnx.helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
        )
        onnx.helper.set_model_props(model, dict(metadata))
        onnx.checker.check_model(model, full_check=True)
        return model.SerializeToString()


class GraphArray(NDArrayOperatorsMixin):
    """An array in a graph; NumPy's functions and operators add nodes."""

    def __init__(self, graph: Graph, name: str) -> None:
        self.graph, self.name = graph, name

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options:
            return NotImplemented
        if function is np.arctan:  # onnxruntime has it in single precision only
            single = self.graph.cast(self._node_name(inputs[0]), "FLOAT")
            return GraphArray(self.graph, self.graph.cast(self.graph.add("Atan", single), "DOUBLE"))
        return self._added(_OPERATORS[function], inputs)

    def __array_function__(self, function: Any, kinds: Any, inputs: Any, options: Any) -> Any:
        return self._added("Where", inputs) if function is np.where else NotImplemented

    def _added(self, kind: str, inputs: Sequence[Any]) -> "GraphArray":
        return GraphArray(self.graph, self.graph.add(kind, *map(self._node_name, inputs)))

    def _node_name(self, value: Any) -> str:
        if isinstance(value, GraphArray):
            return value.name
        return self.graph.array(np.asarray(value, dtype=np.float64))


def add_network_decision(graph: Graph, decision: NetworkDecision) -> str:
    """Add the decision of a network; returns the name of the choices (parcels, parts)."""
    scores = graph.network(decision.network, OBSERVATION)
    shape = graph.integers(-1, decision.groups, len(decision.options))
    best = graph.add("ArgMax", graph.add("Reshape", scores, shape), axis=2, keepdims=0)
    chosen = graph.add("Gather", graph.array(decision.options), best)
    choices = graph.add("Reshape", chosen, graph.integers(-1, decision.parts))
    symmetry = decision.symmetry
    if symmetry is None:
        return choices
    flipped = graph.add("Gather", choices, graph.array(symmetry.parts), axis=1)
    image = graph.add("Gather", graph.array(symmetry.images), flipped)
    side = graph.add("Gather", OBSERVATION, graph.integers(symmetry.side), axis=1)
    mirrored = graph.add("Less", side, graph.array(np.array(0.0, dtype=np.float32)))
    return graph.add("Where", mirrored, image, choices)


EDGE = 1e-9  # differences below this are round-off
_LEAST_COSINE = math.cos(0.5 * math.pi)  # [-] cosine of the double closest to a right angle
_COMPARISONS = (np.less, np.less_equal, np.greater, np.greater_equal)
_APART = ("side", "time")  # features that modules do not see


def seen_by_modules(config: EnvConfig, features: Sequence[Any]) -> tuple[tuple[Any, ...], Any, Any]:
    """Compute the view of each module, in the order of the action.

    Returns:
        Numbers of each module's own view; whether it carries the parcel now or at the next
        decision; and whether the goal side is y < 0. All are arrays (parcels, modules) or (parcels,
        1).
    """
    see = {
        name: decode(column, feature)
        for (name, column), feature in zip(config.columns.items(), features, strict=True)
    }
    kind, line, period = config.action_kind, config.chosen_line, config.control_period
    mirrored = features[SIDE] < 0.0
    offset = see["lateral offset"]
    vx, vy = see["forward speed"], see["lateral speed"]
    sine, cosine = see["sine of theta"], see["cosine of theta"]
    length = _hypot(sine, cosine)
    turned = length > 0.0
    cosine, sine = np.where(turned, cosine / length, 1.0), np.where(turned, sine / length, 0.0)
    outline, into_zone = _lie(config, see, offset, (cosine, sine))
    turn = period * see["turning speed"]
    c, s = np.cos(turn), np.sin(turn)
    later_axes = (cosine * c - sine * s, sine * c + cosine * s)
    row, column = np.divmod(np.arange(kind.size), kind.columns)
    line_y = line.pitch_y * (row - (kind.rows - 1) / 2.0)[np.newaxis]
    x = line.pitch_x * (column + 0.5)[np.newaxis] - into_zone
    y = np.where(mirrored, -1.0, 1.0) * line_y - offset
    now = _from_parcel(x, y, (cosine, sine))
    later = _from_parcel(x - period * vx, y - period * vy, later_axes)
    outside, outside_later = outline.outside(now), outline.outside(later)
    place = (
        now[0] / outline.half[0], now[1] / outline.half[1],
        later[0] / outline.half[0], later[1] / outline.half[1],
        np.where(outside <= 0.0, 1.0, 0.0), np.where(outside_later <= 0.0, 1.0, 0.0),
        x / BESIDE, y / BESIDE, (y + offset) / ACROSS,
        *_axes_around(config, see, x, y),
    )  # fmt: skip
    close = _hypot(*outline.half) + period * (abs(vx) + abs(vy)) + 2.0 * MARGIN
    bears = (
        (np.minimum(outside, outside_later) <= MARGIN)
        & (np.absolute(line_y) < 0.5 * line.pitch_y * outline.rows)
        & (abs(x) < close)
        & (abs(y) < close)
    )
    return place, bears, mirrored


@dataclass(frozen=True, eq=False)
class _Outline:
    half: tuple[Any, Any]  # [m] of its length and width
    roundness: Any  # [-] 0: a rectangle, 1: an ellipse; None: always a rectangle
    rows: Any  # of the line it runs on

    def reach(self, cosine: Any, sine: Any) -> Any:
        """[m] extent of the base along x."""
        (length, width), cosine, sine = self.half, abs(cosine), abs(sine)
        straight = length * cosine + width * sine
        if self.roundness is None:
            return straight
        return straight + self.roundness * (_hypot(length * cosine, width * sine) - straight)

    def outside(self, place: tuple[Any, Any]) -> Any:
        """[m] distance from the base to a position; negative under the base."""
        (along, across), (length, width) = place, self.half
        straight = np.maximum(abs(along) - length, abs(across) - width)
        if self.roundness is None:
            return straight
        bent = (_hypot(along / length, across / width) - 1.0) * np.minimum(length, width)
        return straight + self.roundness * (bent - straight)


def _lie(
    config: EnvConfig, see: dict[str, Any], offset: Any, axes: tuple[Any, Any]
) -> tuple[_Outline, Any]:
    """Return the base's outline, and the distance [m] from the zone's first edge to its centre."""
    line = config.chosen_line
    least = 2.0 if isinstance(line, Line) else float(line.zone_rows)

    def rows(pairs: Any) -> Any:
        return _clip(2.0 * np.floor(pairs), least, float(line.zone_rows))

    cosine, sine = abs(axes[0]), abs(axes[1])
    if "parcel" in config.observe:
        length, width = see["length"], see["width"]
        roundness = _clip((1.0 - see["fill"]) / (1.0 - ELLIPSE), 0.0, 1.0)
        outline = _Outline((length, width), roundness, rows(width / line.pitch_y + EXACT))
        into_zone = see["distance into zone"] + outline.reach(*axes)
        # The nearest place with the shown phase within a pitch.
        phase = _angle(see["sine of phase x"], see["cosine of phase x"])
        in_pitch = 0.5 + phase / (2.0 * math.pi)
        pitch = line.pitch_x
        return outline, pitch * (np.rint(into_zone / pitch - in_pitch) + in_pitch)
    length = see["size"]
    beyond = offset - see["clearance"]
    across = beyond - length * sine
    count = rows((across / line.pitch_y + (1.5 - ROUND)) / (1.0 + cosine))
    half_line = 0.5 * line.pitch_y * (count - 1.0)
    reach = across - half_line
    as_wide = abs(reach - length * cosine) < EXACT
    is_disc = abs(beyond - half_line - length) < EXACT
    width = _clip(reach / np.maximum(cosine, _LEAST_COSINE), 0.5 * length, 2.0 * length)
    outline = _Outline((length, np.where(as_wide | is_disc, length, width)), None, count)
    return outline, see["distance into zone"] + outline.reach(*axes)


def _axes_around(config: EnvConfig, see: dict[str, Any], x: Any, y: Any) -> tuple[Any, ...]:
    """Select the observed rotors' features in a module's quadrant; empty if none are observed."""
    if "rotors" not in config.observe:
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
    """Return the position [m] along and across the parcel's own axes."""
    cosine, sine = axes
    return cosine * x + sine * y, cosine * y - sine * x


def _hypot(one: Any, other: Any) -> Any:
    return np.sqrt(one * one + other * other)


def _clip(value: Any, low: Any, high: Any) -> Any:
    return np.minimum(np.maximum(value, low), high)


def _angle(sine: Any, cosine: Any) -> Any:
    """Return the angle [rad] in [-pi, pi], like `arctan2`."""
    length = _hypot(sine, cosine)
    straight = np.where(cosine < 0.0, math.pi, 0.0)
    level = (sine <= 0.0) & (sine >= 0.0)
    behind = np.where(level, straight, 2.0 * np.arctan((length - cosine) / sine))
    rough = np.where(cosine > 0.0, 2.0 * np.arctan(sine / (length + cosine)), behind)
    # A graph's arc tangent has single precision; the sine gives the rest of the angle.
    left = (sine * np.cos(rough) - cosine * np.sin(rough)) / length
    return np.where(length > 0.0, rough + left, 0.0)


class DoubtArray(NDArrayOperatorsMixin):
    """An array that records where round-off may change a comparison or a jump."""

    def __init__(self, value: Any, doubts: list[Any], exact: bool = False) -> None:
        self.value, self.doubts, self.exact = value, doubts, exact

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options:
            return NotImplemented
        values = [each.value if isinstance(each, DoubtArray) else each for each in inputs]
        rounded = any(isinstance(each, DoubtArray) and not each.exact for each in inputs)
        if function in _COMPARISONS and rounded:
            self.doubts.append(np.abs(values[0] - values[1]) <= EDGE)
        elif function in (np.floor, np.rint):
            steps = values[0] - (0.5 if function is np.rint else 0.0)
            self.doubts.append(np.abs(steps - np.round(steps)) <= EDGE)
        return DoubtArray(function(*values), self.doubts)

    def __array_function__(self, function: Any, kinds: Any, inputs: Any, options: Any) -> Any:
        if function is not np.where:
            return NotImplemented
        values = [each.value if isinstance(each, DoubtArray) else each for each in inputs]
        return DoubtArray(np.where(*values), self.doubts)


@dataclass(frozen=True, eq=False)
class ModulesDecision:
    """Decision of modules: each module under the parcel chooses by one shared network."""

    network: Network
    config: EnvConfig  # of the environment
    shared: Integers  # (shared,) indices of the features that all modules see
    images: Integers  # (choices,) the mirror image of each orientation
    rest: int  # choice of the other modules
    angles: tuple[float, ...]  # [rad] of the orientations on offer

    @property
    def features(self) -> int:
        return len(self.config.features)

    @property
    def parts(self) -> int:
        return self.config.action_kind.size

    def in_doubt(self, observations: Singles, tie: float) -> NDArray[np.bool_]:
        """Return for each module whether round-off may change its choice; see `NetworkDecision`."""
        doubts: list[Any] = []
        columns = observations.astype(np.float64).T[..., np.newaxis]
        with np.errstate(divide="ignore", invalid="ignore"):  # in branches that are not chosen
            own, bearing, _ = seen_by_modules(
                self.config, [DoubtArray(column, doubts, exact=True) for column in columns]
            )
        shape = (len(observations), self.parts)
        place = np.stack([np.broadcast_to(each.value, shape) for each in own], axis=2)
        alike = np.repeat(observations[:, np.newaxis, self.shared], self.parts, axis=1)
        inputs = np.concatenate([alike, place.astype(np.float32)], axis=2)
        bears = np.broadcast_to(bearing.value, shape)
        close = np.zeros(shape, dtype=np.bool_)
        close[bears] = are_close(self.network.scores(inputs[bears].astype(np.float64)), tie)
        for doubt in doubts:
            close |= doubt
        return close


def add_modules_decision(graph: Graph, decision: ModulesDecision) -> str:
    """Add the decision of modules; returns the name of the choices (parcels, parts)."""
    seen, bears, mirrored = seen_by_modules(decision.config, graph.features(decision.features))
    last = graph.integers(2)
    place = [graph.add("Unsqueeze", each.name, last) for each in seen]
    alike = graph.add("Gather", OBSERVATION, graph.array(decision.shared), axis=1)
    one = graph.add("Unsqueeze", alike, graph.integers(1))
    each = graph.add("Expand", one, graph.integers(1, decision.parts, 1))
    own = graph.cast(graph.add("Concat", *place, axis=2), "FLOAT")
    inputs = graph.add("Concat", each, own, axis=2)
    scores = graph.network(decision.network, inputs)
    best = graph.add("ArgMax", scores, axis=2, keepdims=0)
    image = graph.add("Gather", graph.array(decision.images), best)
    turned = graph.add("Where", mirrored.name, image, best)
    return graph.add("Where", bears.name, turned, graph.array(np.array(decision.rest)))


def modules_decision(source: Source) -> ModulesDecision:
    """Return the decision of modules that share weights, for the zone they were trained on."""
    config = source.config
    angles = config.chosen_orientations
    names = [each.name for each in config.features]
    arrays = {name: to_array(values) for name, values in source.weights.items()}
    # Weights of the shared features and of each module's own features, side by side.
    first = np.concatenate([arrays["_alike.weight"], arrays["_apart.weight"]], axis=1)
    between = sorted({int(name.split(".")[1]) for name in arrays if name.startswith("_between.")})
    later = [f"_between.{k}" for k in between] + ["_logits"]
    layers = [Layer(arrays[f"{name}.weight"], arrays[f"{name}.bias"]) for name in later]
    return ModulesDecision(
        Network((Layer(first, arrays["_alike.bias"]), *layers), "tanh"),
        config,
        np.array([k for k, name in enumerate(names) if name not in _APART], dtype=np.int64),
        config.images,
        int(np.abs(np.sin(angles)).argmax()),
        angles,
    )
