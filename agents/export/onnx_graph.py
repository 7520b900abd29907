"""ONNX graphs: built node by node, or by NumPy's own functions on traced arrays."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from .policy import Network, NetworkDecision

OPSET = 17  # version of ONNX's operators
IR_VERSION = 8  # of the file format, which goes with it
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
    """Import a library of the extra `export`.

    Raises:
        ImportError: it is missing; the message says what to install.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"an export needs {error.name}, which is not installed: "
            "pip install 'surface_gym[agents,export]'"
        ) from None


class Graph:
    """Nodes and constants; each method adds some and returns the name of the result."""

    def __init__(self) -> None:
        self._onnx = need("onnx")
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """Add a node with one output, named by the caller or by its place."""
        output = output or f"{kind.lower()} {len(self._nodes)}"
        made = self._onnx.helper.make_node(kind, list(inputs), [output], **attributes)
        self._nodes.append(made)
        return output

    def array(self, values: NDArray[Any]) -> str:
        """Add a constant of its own type."""
        name = f"constant {len(self._constants)}"
        self._constants.append(self._onnx.numpy_helper.from_array(np.asarray(values), name))
        return name

    def integers(self, *values: int) -> str:
        """Add a constant of integers, for shapes and indices."""
        return self.array(np.array(values, dtype=np.int64))

    def cast(self, value: str, kind: str) -> str:
        """Convert numbers to another kind, "FLOAT" or "DOUBLE"."""
        return self.add("Cast", value, to=getattr(self._onnx.TensorProto, kind))

    def network(self, network: Network, values: str) -> str:
        """Compute scores (..., outputs) of values (..., inputs)."""
        for k, layer in enumerate(network.layers):
            if k:
                values = self.add(_ACTIVATIONS[network.activation], values)
            values = self.add("MatMul", values, self.array(layer.weights.T.copy()))
            values = self.add("Add", values, self.array(layer.bias))
        return values

    def features(self, count: int) -> list["Traced"]:
        """Return each feature of the observation, (parcels, 1) in double precision."""
        doubles = self.cast(OBSERVATION, "DOUBLE")
        gathered = (self.add("Gather", doubles, self.integers(k), axis=1) for k in range(count))
        return [Traced(self, name) for name in gathered]

    def model(
        self,
        shape: tuple[int, int],
        orientations: Sequence[float],
        choices: str,
        metadata: Mapping[str, str],
    ) -> bytes:
        """Return the checked model as it is written to a file.

        Args:
            shape: (features, parts), sizes of an observation and of a decision.
            orientations: [rad] of the choices.
            choices: name of the choices (parcels, parts).
            metadata: names and values.
        """
        onnx = self._onnx
        self.add("Identity", choices, output=CHOICES)
        self.add("Gather", self.array(np.array(orientations)), choices, output=ANGLES)
        kinds, value = onnx.TensorProto, onnx.helper.make_tensor_value_info
        graph = onnx.helper.make_graph(
            self._nodes,
            "decide",
            [value(OBSERVATION, kinds.FLOAT, ["lanes", shape[0]])],
            [
                value(CHOICES, kinds.INT64, ["lanes", shape[1]]),
                value(ANGLES, kinds.DOUBLE, ["lanes", shape[1]]),
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
        written: bytes = model.SerializeToString()
        return written


class Traced(NDArrayOperatorsMixin):
    """An array of a graph: NumPy's functions and operators on it add nodes.

    Args:
        graph: that it is of.
        name: in the graph.
    """

    def __init__(self, graph: Graph, name: str) -> None:
        self.graph, self.name = graph, name

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or options:
            return NotImplemented
        if function is np.arctan:  # onnxruntime has it in single precision alone
            single = self.graph.cast(self._name_of(inputs[0]), "FLOAT")
            return Traced(self.graph, self.graph.cast(self.graph.add("Atan", single), "DOUBLE"))
        return self._added(_OPERATORS[function], inputs)

    def __array_function__(self, function: Any, kinds: Any, inputs: Any, options: Any) -> Any:
        return self._added("Where", inputs) if function is np.where else NotImplemented

    def _added(self, kind: str, inputs: Sequence[Any]) -> "Traced":
        return Traced(self.graph, self.graph.add(kind, *map(self._name_of, inputs)))

    def _name_of(self, value: Any) -> str:
        if isinstance(value, Traced):
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
