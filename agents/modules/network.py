"""The weights that all modules share, and the value of what a lane sees."""

import math
from itertools import pairwise

import torch
from torch import nn

from surface_gym.core.actions import group_features

from ..mirror import SIDE
from .view import place_size, shared_size


def _linear(inputs: int, outputs: int, gain: float = math.sqrt(2.0)) -> nn.Linear:
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def _layers(units: tuple[int, ...]) -> list[nn.Module]:
    return [layer for sizes in pairwise(units) for layer in (_linear(*sizes), nn.Tanh())]


class SharedNetwork(nn.Module):
    """From what all modules of a lane see, and a module's own place, to its logits.

    A module's place counts for nothing at first: modules learn to act together before they learn
    to differ. Begun otherwise, they settle for the fixed layout.

    Args:
        choices: orientations on offer.
        hidden: units of the hidden layers.
        observe: groups of features that the observation shows beside the task's.
    """

    def __init__(
        self, choices: int, hidden: tuple[int, ...], observe: tuple[str, ...] = ()
    ) -> None:
        super().__init__()
        self._alike = _linear(shared_size(observe), hidden[0])
        self._apart = nn.Linear(place_size(observe), hidden[0], bias=False)
        nn.init.zeros_(self._apart.weight)
        self._between = nn.Sequential(*_layers(hidden))
        self._logits = _linear(hidden[-1], choices, 0.01)

    def forward(
        self, shared: torch.Tensor, lane: torch.Tensor, place: torch.Tensor
    ) -> torch.Tensor:
        """Log probabilities (modules, choices).

        Args:
            shared: (lanes, shared).
            lane: (modules,) each module's.
            place: (modules, place).
        """
        first = torch.tanh(self._alike(shared)[lane] + self._apart(place))
        logits: torch.Tensor = self._logits(self._between(first))
        return logits.log_softmax(dim=1)


class ValueNetwork(nn.Module):
    """What a lane's future is worth, by all that is observed of it but the side.

    Args:
        hidden: units of the hidden layers.
        observe: groups of features that the observation shows beside the task's.
    """

    def __init__(self, hidden: tuple[int, ...], observe: tuple[str, ...] = ()) -> None:
        super().__init__()
        inputs = SIDE + len(group_features(observe))
        self._layers = nn.Sequential(*_layers((inputs, *hidden)), _linear(hidden[-1], 1, 1.0))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """(lanes,) of observations (lanes, features)."""
        but_side = torch.cat([observations[:, :SIDE], observations[:, SIDE + 1 :]], dim=1)
        value: torch.Tensor = self._layers(but_side)[:, 0]
        return value
