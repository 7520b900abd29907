"""A policy that all parcels of a flow share."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from surface_gym.flow.features import PRESENT
from surface_gym.flow.settings import FlowSettings

from ..policy_card import PolicyCard
from .seat_policy import SeatPolicy
from .seats import SeatActions, seat_rows, seat_space


def settings_of(card: PolicyCard) -> FlowSettings:
    """Those of a flow that the policy of a card is for."""
    return FlowSettings(**card.env_kwargs)


def make_seat_network(card: PolicyCard) -> SeatPolicy:
    """The network of a card, its weights not set."""
    return SeatPolicy(*seat_space(settings_of(card)), lambda _: 0.0, net_arch=list(card.hidden))


class FlowPolicy:
    """Decides for each parcel of a flow by its row alone, and for the one at the gate.

    Attributes:
        env_id: the environment it was trained on.
        env_kwargs: that environment's arguments.
    """

    def __init__(self, network: SeatPolicy, card: PolicyCard) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        self._network = network
        self._network.set_training_mode(False)
        settings = settings_of(card)
        self._actions = SeatActions(settings)
        self.card = card
        self.env_id = card.env_id
        self.env_kwargs = card.env_kwargs

    def predict(
        self,
        observation: NDArray[np.float32],
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:
        """Action for an observation (rows, features), or actions for (lanes, rows, features)."""
        del state, episode_start  # it has no memory
        tables = observation.reshape(-1, *observation.shape[-2:])
        there = tables[..., PRESENT] > 0.5
        said = np.zeros((*there.shape, 3), dtype=np.int64)
        if there.any():
            said[there], _ = self._network.predict(
                seat_rows(tables[there]), deterministic=deterministic
            )
        actions = self._actions(tables, said)
        return (actions[0] if observation.ndim == 2 else actions), None
