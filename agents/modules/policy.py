"""The shared weights as a policy, for any zone."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..policy_card import PolicyCard
from .draw import GROUPS, draw_choices
from .network import SharedNetwork
from .view import ModuleView


class ModulesPolicy:
    """Modules that decide by shared weights. `predict` takes and gives what the environment does.

    Attributes:
        env_id: the environment it was trained on.
        env_kwargs: that environment's arguments.

    Args:
        network: the weights.
        card: what they are for.
        zone: first and last column that obey; None: those after the lead-in, as in training.

    Raises:
        ValueError: a zone that is not on the surface.
    """

    def __init__(
        self, network: SharedNetwork, card: PolicyCard, zone: tuple[int, int] | None = None
    ) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        self._network = network.eval()
        self._view = ModuleView(replace(card.settings(), zone=zone))
        self.card = card
        self.env_id = card.env_id
        self.env_kwargs = card.env_kwargs if zone is None else {**card.env_kwargs, "zone": zone}

    def on(self, zone: tuple[int, int] | None) -> "ModulesPolicy":
        """The same weights for another zone."""
        return ModulesPolicy(self._network, self.card, zone)

    @torch.no_grad()
    def predict(
        self,
        observation: NDArray[np.float32],
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.int64], None]:
        """Action for an observation (features,), or actions for (lanes, features); and no state.

        Where it is not to be deterministic, all modules of a lane share a draw, as they learned to.
        """
        del state, episode_start  # it has no memory
        observations = np.atleast_2d(observation)
        seen = self._view(observations)
        shared, lane, place = map(torch.from_numpy, (seen.shared, seen.lane, seen.place))
        log_probability = self._network(shared, lane, place)
        if deterministic:
            choices = log_probability.argmax(dim=1)
        else:
            uniform = torch.rand(GROUPS * len(observations))
            choices = draw_choices(log_probability, GROUPS * lane, uniform)
        actions = self._view.actions(observations, seen, choices.numpy())
        return (actions[0] if np.ndim(observation) == 1 else actions), None
