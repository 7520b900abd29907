"""ONNX graphs, built node by node."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .formula import ARC_TANGENT, CONSTANT, FEATURE, OF_MODULE, OPERATIONS, Formula, in_order
from .network import Network

OPSET = 17  # of ONNX: what every operator here means
IR_VERSION = 8  # of the file format, which goes with it
OBSERVATION, CHOICES, ANGLES = "observation", "choices", "angles"
_ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu"}


def need(package: str) -> Any:
    """A library of the extra `export`, imported only now.

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
    """Nodes and constants; each method adds some and gives the name of what comes out."""

    def __init__(self) -> None:
        self._onnx = need("onnx")
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """A node with one output."""
        output = f"{kind.lower()} {len(self._nodes)}"
        return self.add_as(output, kind, *inputs, **attributes)

    def add_as(self, output: str, kind: str, *inputs: str, **attributes: Any) -> str:
        """A node whose output has a name of its own."""
        made = self._onnx.helper.make_node(kind, list(inputs), [output], **attributes)
        self._nodes.append(made)
        return output

    def array(self, values: NDArray[Any]) -> str:
        """A constant, of its own type."""
        name = f"constant {len(self._constants)}"
        self._constants.append(self._onnx.numpy_helper.from_array(np.asarray(values), name))
        return name

    def whole(self, *values: int) -> str:
        """Whole numbers, for shapes and places."""
        return self.array(np.array(values, dtype=np.int64))

    def cast(self, value: str, kind: str) -> str:
        """As numbers of another kind, "FLOAT" or "DOUBLE"."""
        return self.add("Cast", value, to=getattr(self._onnx.TensorProto, kind))

    def network(self, network: Network, values: str) -> str:
        """(..., outputs) of values (..., inputs)."""
        for k, layer in enumerate(network.layers):
            if k:
                values = self.add(_ACTIVATIONS[network.activation], values)
            values = self.add("MatMul", values, self.array(layer.weights.T.copy()))
            values = self.add("Add", values, self.array(layer.bias))
        return values

    def formulas(self, formulas: Sequence[Formula]) -> list[str]:
        """Values (lanes, modules), or (lanes, 1), of formulas of the observation."""
        doubles = self.cast(OBSERVATION, "DOUBLE")
        names: dict[int, str] = {}
        for each in in_order(formulas):
            if each.kind == FEATURE:
                name = self.add("Gather", doubles, self.whole(int(each.value)), axis=1)
            elif each.kind == CONSTANT:
                name = self.array(np.array([[each.value]]))
            elif each.kind == OF_MODULE:
                name = self.array(np.array([each.values]))
            elif each.kind == ARC_TANGENT:  # onnxruntime has it of single precision alone
                single = self.cast(names[id(each.operands[0])], "FLOAT")
                name = self.cast(self.add("Atan", single), "DOUBLE")
            else:
                operands = (names[id(part)] for part in each.operands)
                name = self.add(OPERATIONS[each.kind][1], *operands)
            names[id(each)] = name
        return [names[id(each)] for each in formulas]

    def model(
        self, features: int, parts: int, choices: str, angles: str, told: Mapping[str, str]
    ) -> bytes:
        """The checked model as it is written to a file.

        Args:
            features: numbers of an observation.
            parts: numbers of a decision.
            choices: name of what has them (lanes, parts).
            angles: name of what has them (lanes, parts) [rad].
            told: metadata.
        """
        onnx = self._onnx
        kinds, value = onnx.TensorProto, onnx.helper.make_tensor_value_info
        self.add_as(CHOICES, "Identity", choices)
        self.add_as(ANGLES, "Identity", angles)
        graph = onnx.helper.make_graph(
            self._nodes,
            "decide",
            [value(OBSERVATION, kinds.FLOAT, ["lanes", features])],
            [
                value(CHOICES, kinds.INT64, ["lanes", parts]),
                value(ANGLES, kinds.DOUBLE, ["lanes", parts]),
            ],
            self._constants,
        )
        model = onnx.helper.make_model(
            graph,
            producer_name="surface_gym",
            opset_imports=[onnx.helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
        )
        onnx.helper.set_model_props(model, dict(told))
        onnx.checker.check_model(model, full_check=True)
        written: bytes = model.SerializeToString()
        return written
