"""Policy of modules on a slope with local observations.

All modules share one network. The modules under a parcel share one number, by which each samples
from its own probabilities. So similar modules choose alike, and a parcel is not pulled back and
forth. The number is constant for some control periods, since axes take time to turn.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn

from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.module_view import OWN, PASSED, ModuleView
from surface_gym.flow.state import NOBODY

from .base import Integers, Singles
from .library import PolicyCard, Weights
from .module_policy import draw_choices
from .parcel_policy import SlopePolicy, suited
from .tensors import load_weights

MOST = 5.0  # limit of features
HOLD = 2  # control periods for which the shared number is constant
NUMBERS = 4099  # size of the table of numbers, a prime
APART = 97  # offset between the table's rows
CENTRE = len(OWN) - 3  # feature of a module: distance ahead of the parcel's centre


class LocalInputs(NamedTuple):
    """Observations of the modules under parcels in all environments, grouped by parcel."""

    row: Integers  # (parcels,) row among all rows of all environments
    passed: torch.Tensor  # (parcels, PASSED) features shared by the modules under each parcel
    env: Integers  # (modules,) environment
    module: Integers  # (modules,) index in the action
    parcel: torch.Tensor  # (modules,) index among the parcels
    own: torch.Tensor  # (modules, len(OWN))


def see_modules(view: ModuleView, tables: Singles) -> LocalInputs:
    """Return modules' observations from tables (num_envs, rows, features)."""
    seen = view(tables)
    num_envs, rows = seen.passed.shape[:2]
    row = np.flatnonzero(seen.passed[..., 0] > 0.5)
    env, module = np.nonzero(seen.owner != NOBODY)
    parcel = np.searchsorted(row, env * rows + seen.owner[env, module])
    order = np.argsort(parcel, kind="stable")
    env, module, parcel = env[order], module[order], parcel[order]
    passed = seen.passed.reshape(num_envs * rows, PASSED)[row]
    own = seen.own[env, module]
    return LocalInputs(
        row, torch.from_numpy(passed.clip(-MOST, MOST)),
        env, module, torch.from_numpy(parcel), torch.from_numpy(own.clip(-MOST, MOST)),
    )  # fmt: skip


class LocalNetwork(nn.Module):
    """Actor of modules, and critic of parcels."""

    def __init__(self, choices: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self.actor = _perceptron((PASSED + len(OWN), *hidden, choices))
        self.critic = _perceptron((PASSED, *hidden, 1))

    def forward(self, passed: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
        """Compute log probabilities (modules, choices)."""
        logits: torch.Tensor = self.actor(torch.cat([passed, own], dim=1))
        return logits.log_softmax(dim=1)

    def value(self, passed: torch.Tensor) -> torch.Tensor:
        """Compute the expected returns (parcels,) of parcels."""
        found: torch.Tensor = self.critic(passed)[:, 0]
        return found


def _perceptron(units: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, after in pairwise(units):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class LocalPolicy(SlopePolicy):
    """A trained policy of modules on a slope.

    Args:
        config: configuration of the environment.
    """

    def __init__(self, network: LocalNetwork, card: PolicyCard, config: EnvConfig) -> None:
        super().__init__(network, card, config)
        self._network = network
        self._view = ModuleView(self._config)
        self._rest = find_rest(self._config)
        self._numbers = find_numbers()

    @torch.no_grad()
    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        seen = see_modules(self._view, batch)
        log_probability = self._network(seen.passed[seen.parcel], seen.own)
        number = self._agree(batch, seen.row) if deterministic else torch.rand(len(seen.row))
        choice = draw_choices(log_probability, seen.parcel, number)
        return fill(seen, choice.numpy(), len(batch), self._view.modules, self._rest), None

    def _agree(self, tables: Singles, row: Integers) -> torch.Tensor:
        """Return the numbers (parcels,) shared by the modules under each parcel.

        They depend on the parcel's time on the surface, and on its row in the table.
        """
        rows = tables.shape[1]
        since = ta.COLUMN.time.of(tables).reshape(-1)[row] / self._config.control_period
        place = (since / HOLD + 1e-3).astype(np.int64) + APART * (row % rows)
        return torch.from_numpy(self._numbers[place % NUMBERS])


def find_numbers() -> Singles:
    """Return the table of shared numbers (NUMBERS,) in [0, 1), which is constant."""
    return np.random.default_rng(0).random(NUMBERS, dtype=np.float32)


def find_rest(config: EnvConfig) -> int:
    """Return the choice closest to 90 deg, for modules without a parcel."""
    return int(np.abs(np.sin(config.chosen_orientations)).argmax())


def fill(seen: LocalInputs, choice: Integers, num_envs: int, modules: int, rest: int) -> Integers:
    """Build actions (num_envs, modules) from choices (modules with a parcel,)."""
    actions = np.full((num_envs, modules), rest)
    actions[seen.env, seen.module] = choice
    return actions


def build_local(
    card: PolicyCard, weights: Weights, own: EnvConfig, config: EnvConfig | None = None
) -> LocalPolicy:
    """Build a policy of modules on a slope from its weights.

    Args:
        own: environment on the card.
        config: environment of the policy; None: the card's.
    """

    def make() -> LocalNetwork:
        return LocalNetwork(len(own.chosen_orientations), card.hidden)

    return LocalPolicy(load_weights(make, card.hidden, weights), card, suited(own, config))
