"""Policy that schedules a stream, with a network that predicts how often parcels touch.
Parcels wait at a gate. A maneuver, or option, is a position and an angle at which a parcel turns
off to its exit. A candidate is an option with a level of clearance for the next parcel at the gate.

The scheduler lists the candidates. A network with attention looks at the other parcels, and
predicts each candidate's touches. The policy takes the candidate with the least cost of time and
touches.
"""

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import nn

from surface_gym.config import EnvConfig

from .base import Integers
from .library import PolicyCard, TrainedPolicy, Weights
from .scheduling.decisions import ABOUT, LEVELS, OPTION, TOKEN, DecidingScheduler, Decisions
from .scheduling.scheduler import Scheduler, find_plain, find_quiet
from .tensors import load_weights

# [-] candidate prices of a touch, in parcels that the line could have delivered.
PRICES = np.geomspace(0.3, 50.0, 24)
BETTER = 1.01  # required ratio of deliveries in a trial for using the network
RISK = (-8.0, 2.0)  # limits of the logarithm of expected touches
FIRST, FALL = -2.0, -1.0  # initial value at the tightest level, and decrease by level


class ScheduleNetwork(nn.Module):
    """Network that predicts each candidate's touches. More clearance gives fewer touches."""

    def __init__(self, hidden: tuple[int, ...]) -> None:
        super().__init__()
        units = hidden[0]
        self.option = nn.Sequential(nn.Linear(OPTION + ABOUT, units), nn.ReLU())
        self.token = nn.Sequential(nn.Linear(TOKEN, units), nn.ReLU(), nn.Linear(units, 2 * units))
        self.query = nn.Linear(units, units)
        layers: list[nn.Module] = []
        width = 2 * units
        for each in hidden[1:]:
            layers += [nn.Linear(width, each), nn.ReLU()]
            width = each
        self.joint = nn.Sequential(*layers)
        self.last = nn.Linear(width, len(LEVELS))
        nn.init.zeros_(self.last.weight)
        with torch.no_grad():
            self.last.bias.fill_(FALL)
            self.last.bias[0] = FIRST

    def forward(
        self, option: torch.Tensor, token: torch.Tensor, shown: torch.Tensor, about: torch.Tensor
    ) -> torch.Tensor:
        """Compute the logarithm of expected touches (decisions, options, levels).

        Args:
            option: (decisions, options, OPTION) features of each option.
            token: (decisions, tokens, TOKEN) features of other parcels.
            shown: (decisions, tokens) whether a token is a parcel; other tokens are empty.
            about: (decisions, ABOUT) features of the line.
        """
        each = torch.cat([option, about[:, None].expand(-1, option.shape[1], -1)], dim=2)
        own = self.option(each)
        key, value = self.token(token).chunk(2, dim=2)
        score = self.query(own) @ key.transpose(1, 2) / key.shape[2] ** 0.5
        score = score.masked_fill(~shown[:, None], RISK[0] * 1e4)
        found = self.last(self.joint(torch.cat([own, score.softmax(dim=2) @ value], dim=2)))
        falls = nn.functional.softplus(found[..., 1:]).cumsum(dim=2)
        return torch.cat([found[..., :1], found[..., :1] - falls], dim=2).clamp(*RISK)


def as_tensors(decisions: Decisions) -> tuple[torch.Tensor, ...]:
    """Return the decisions' features as the arguments of `ScheduleNetwork.forward`."""
    return (
        torch.from_numpy(decisions.option), torch.from_numpy(decisions.token),
        torch.from_numpy(decisions.shown), torch.from_numpy(decisions.about),
    )  # fmt: skip


class NetworkScheduler(DecidingScheduler):
    """Scheduler that minimises the cost of time and of expected touches."""

    price = 1.0  # [-] of a touch, in parcels that the line could have delivered

    def __init__(self, config: EnvConfig, network: ScheduleNetwork) -> None:
        super().__init__(config)
        self._network = network

    def at_price(self, price: float) -> "NetworkScheduler":
        """Return a copy of this scheduler with another price of a touch."""
        found = copy(self)
        found.price = price
        return found

    def choose(self, decisions: Decisions) -> tuple[Integers, Integers]:
        cost = decisions.cost + self.price * np.exp(self.risk(decisions))
        option, level = np.divmod(cost.reshape(len(cost), -1).argmin(axis=1), len(LEVELS))
        return option, level

    @torch.no_grad()
    def risk(self, decisions: Decisions) -> Any:
        """Compute the logarithm (decisions, options, levels) of the expected number of touches."""
        return self._network(*as_tensors(decisions)).numpy()


class SchedulePolicy(TrainedPolicy):
    """A trained policy that schedules an environment's stream.

    The first call simulates maneuvers and trials, which takes seconds. A trial simulates a
    busy stream. Trials find the price of a touch, i.e. the number of deliveries that the scheduler
    gives up to avoid a touch. `config` must have a gate and actions "parcels". `most_touches` [-]
    is the allowed number of touches per delivery in a trial.
    """

    def __init__(
        self,
        network: ScheduleNetwork,
        card: PolicyCard,
        config: EnvConfig,
        most_touches: float = 0.0,
    ) -> None:
        super().__init__(card, config)
        self._network = network
        if not config.stream_task.gate:
            raise ValueError("gate must be True for a policy on a schedule, got False")
        self._shape = (config.rows, len(config.features))
        self._most_touches = most_touches

    @cached_property
    def scheduler(self) -> Scheduler:
        """The better of a scheduler that uses the network and a scheduler with fixed clearances.

        Each scheduler is tried on a simulated stream. The scheduler with the network is better if
        it delivers more than `BETTER` times as many parcels as the other scheduler.
        """
        config, most = self._config, self._most_touches
        learned = NetworkScheduler(config, self._network)
        best, right = find_quiet(config, lambda k: learned.at_price(PRICES[k]), len(PRICES), most)
        plain, more = find_plain(config, learned.library, most)
        return best if right > BETTER * more else plain

    def _predict(
        self, batch: Any, state: Any, episode_start: Any, *, deterministic: bool
    ) -> tuple[Any, Any]:
        return self.scheduler.predict(batch, state, episode_start, deterministic)


def build_schedule(
    card: PolicyCard,
    weights: Weights,
    own: EnvConfig,
    config: EnvConfig | None = None,
    most_touches: float = 0.0,
) -> SchedulePolicy:
    """Build a `SchedulePolicy` for the environment `config`.

    If `config` is None, use `own`, the environment of the card. The policy tests schedules in
    trials, and chooses a schedule with at most `most_touches` [-] touches per delivery.
    """
    network = load_weights(lambda: ScheduleNetwork(card.hidden), card.hidden, weights)
    return SchedulePolicy(network, card, own if config is None else config, most_touches)
