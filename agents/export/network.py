"""Layers of a trained network as plain arrays."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

Singles = NDArray[np.float32]
Numbers = NDArray[np.float64]

ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", nn.ReLU: "relu"}


@dataclass(frozen=True, eq=False)
class Layer:
    """Outputs are weights times inputs, plus the bias."""

    weights: Singles  # (outputs, inputs)
    bias: Singles  # (outputs,)


@dataclass(frozen=True, eq=False)
class Network:
    """Layers one after the other, with one activation between them and none at the end."""

    layers: tuple[Layer, ...]
    activation: str  # "tanh" or "relu"

    @property
    def inputs(self) -> int:
        """Numbers that go in."""
        return int(self.layers[0].weights.shape[1])

    @property
    def outputs(self) -> int:
        """Numbers that come out."""
        return len(self.layers[-1].bias)

    @property
    def widest(self) -> int:
        """Numbers of the widest layer, what goes in and comes out included."""
        return max(self.inputs, *(len(layer.bias) for layer in self.layers))

    def scores(self, inputs: Numbers) -> Numbers:
        """(..., outputs) of inputs (..., inputs), in double precision."""
        values = inputs
        for k, layer in enumerate(self.layers):
            if k:
                values = np.tanh(values) if self.activation == "tanh" else np.maximum(values, 0.0)
            values = values @ layer.weights.T.astype(np.float64) + layer.bias
        return values


def network_of(modules: nn.Module) -> Network:
    """A network of modules that follow each other.

    Raises:
        ValueError: it has other than linear layers with one kind of activation between them.
    """
    leaves = [each for each in modules.modules() if not list(each.children())]
    linear, between = leaves[::2], leaves[1::2]
    kinds = {type(each) for each in between}
    if (
        len(linear) != len(between) + 1
        or not all(isinstance(each, nn.Linear) for each in linear)
        or len(kinds) != 1
        or not kinds <= set(ACTIVATIONS)
    ):
        told = ", ".join(type(each).__name__ for each in leaves)
        raise ValueError(
            "network must be linear layers with Tanh, or with ReLU, between each two, to be "
            f"exported, got {told}"
        )
    layers = tuple(
        Layer(array_of(each.weight), array_of(each.bias))
        for each in linear
        if isinstance(each, nn.Linear)
    )
    return Network(layers, ACTIVATIONS[kinds.pop()])


def array_of(weights: torch.Tensor) -> Singles:
    """Weights as an array of their own."""
    copied: Singles = weights.detach().numpy().astype(np.float32, copy=True)
    return copied
