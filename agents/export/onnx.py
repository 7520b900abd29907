"""Policies as ONNX graphs."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .policy import Network, NetworkDecision

OPSET = 17  # version of ONNX's operators
IR_VERSION = 8  # version of the file format for this OPSET
OBSERVATION, CHOICES, ANGLES = "observation", "choices", "angles"
_ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu"}


def need(package: str) -> Any:
    """Import a package, or raise an ImportError that names the extra `export`."""
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"an export needs {error.name}, which is not installed: "
            "pip install 'surface_gym[agents,export]'"
        ) from None


class Graph:
    """Nodes and constants of an ONNX graph. A method returns the name of the new output."""

    def __init__(self) -> None:
        self._onnx = need("onnx")
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """Add a node with one output. The output's default name is the node's kind and index."""
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

    def network(self, network: Network, values: str) -> str:
        """Add a network that computes scores (..., outputs) of values (..., inputs)."""
        for k, layer in enumerate(network.layers):
            if k:
                values = self.add(_ACTIVATIONS[network.activation], values)
            values = self.add("MatMul", values, self.array(layer.weights.T.copy()))
            values = self.add("Add", values, self.array(layer.bias))
        return values

    def model(
        self,
        shape: tuple[int, int],
        orientations: Sequence[float],
        choices: str,
        metadata: Mapping[str, str],
    ) -> bytes:
        """Add the file's outputs, let ONNX check the graph, and return the file's content.

        Args:
            shape: number of features, and number of choices.
            orientations: [rad] angle of each choice.
            choices: name of the tensor of choices (num_envs, parts) in the graph.
            metadata: texts by key, stored in the file.
        """
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


def make_model(decision: NetworkDecision, metadata: Mapping[str, str]) -> bytes:
    """Return the content of an ONNX file that makes a policy's decisions and has `metadata`."""
    graph = Graph()
    choices = _add_decision(graph, decision)
    return graph.model((decision.features, decision.parts), decision.angles, choices, metadata)


def _add_decision(graph: Graph, decision: NetworkDecision) -> str:
    """Add a decision's nodes to a graph; return the name of the output (num_envs, parts)."""
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
