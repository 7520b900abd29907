"""Policies on slopes: `ParcelPolicy` decides for parcels, `LocalPolicy` for modules.
The observation is a table with a row for each parcel.

`ParcelPolicy` corrects a rule's choices. A parcel's choice depends on its own row and, by
attention, on the rows of all other parcels. So the number and the order of parcels do not matter.
This is residual policy learning (Silver et al. 2018): before training, the policy nearly equals the
rule. For a task without a rule, the network decides alone.

`LocalPolicy` uses local observations of modules. The modules under a parcel share one random
number, which selects each module's choice by its own probabilities. So similar modules choose
alike, and a parcel is not pulled back and forth. The number is constant for some control periods,
since axes take time to turn.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.base import HALVES
from surface_gym.flow.module_view import OWN, PASSED, ModuleView
from surface_gym.flow.state import NOBODY
from surface_gym.tasks.features import Column, Feature, columns

from .base import Booleans, Integers, Numbers, Singles, find_rest, is_fresh
from .library import HEADS, PolicyCard, TrainedPolicy, Weights, check_heads
from .rules import find_prior
from .tensors import draw_choices, load_weights

MOST = 5.0  # limit of features
PAIR_RANGE = (2.0, 1.4, 2.0)  # maximum differences of two parcels: [m] along, [m] across and [m/s]
PAIR = 5  # features of the relative position of two parcels
PRIOR = 6.0  # initial logit of the rule's choice, for a probability of 0.96
SMALL = 0.01  # [-] scale of the last layer's initial weights
# Features of relative positions: x minus the length, y, and vx.
PLACE = {"to the end": -1.0, "offset": 1.0, "forward speed": 1.0}  # [-] sign of each feature
# features of a row: presence of a parcel, and time since its entry
PRESENT, TIME = "present", "time"


class ParcelValues(NamedTuple):
    """Outputs of a network for the parcels that are present."""

    row: torch.Tensor  # (parcels,) row among the rows of all environments
    logits: torch.Tensor  # (parcels, choices)
    value: torch.Tensor  # (parcels,) expected return


class ParcelNetwork(nn.Module):
    """Actor and critic of each parcel, with attention over the parcels of its surface.

    Args:
        features: definitions of the features in a row of the table.
        orientations: number of orientations. A choice gives one orientation to the modules ahead of
            the parcel's centre, and one orientation to the modules behind the centre.
        hidden: tuple (units,), the number of units of the only hidden layer.
    """

    def __init__(
        self,
        features: Sequence[Feature],
        orientations: int,
        hidden: tuple[int, ...],
        has_rule: bool = True,
    ) -> None:
        super().__init__()
        check_heads(hidden)
        units = hidden[0]
        self.choices = orientations**HALVES
        self._has_rule = has_rule
        names = [each.name for each in features]
        self._present = names.index(PRESENT)
        self._place = [names.index(name) for name in PLACE if PLACE.keys() <= set(names)]
        self._scale = torch.tensor([PLACE[names[k]] * features[k].scale for k in self._place])
        inputs = len(features) + (self.choices if has_rule else 0)
        self.encoder = nn.Sequential(
            nn.Linear(inputs, units), nn.ReLU(), nn.Linear(units, units), nn.ReLU()
        )
        self.attend = nn.Linear(units, 3 * units)  # query, key and value
        # Attention of two parcels by their relative position.
        self.pair = nn.Linear(PAIR, HEADS) if self._place else None
        last = nn.Linear(units, self.choices)
        with torch.no_grad():
            last.weight.mul_(SMALL)
            last.bias.zero_()
        self.actor = nn.Sequential(nn.Linear(2 * units, units), nn.ReLU(), last)
        self.critic = nn.Sequential(nn.Linear(2 * units, units), nn.ReLU(), nn.Linear(units, 1))

    def find_present(self, tables: torch.Tensor) -> torch.Tensor:
        """Return booleans (num_envs, rows) that say whether a row of the tables holds a parcel."""
        return tables[..., self._present] > 0.5

    def forward(self, tables: torch.Tensor, proposed: torch.Tensor) -> ParcelValues:
        """Compute each parcel's expected return, and the logits of each parcel's choices.

        `tables` have shape (num_envs, rows, features). `proposed` (num_envs, rows) are the choices
        of the rule that the policy corrects. Without this rule, `proposed` has no effect.
        """
        present = self.find_present(tables)
        index = present.flatten().nonzero()[:, 0]
        rows = tables.flatten(0, 1)[index].clamp(-MOST, MOST)
        inputs, prior = [rows], torch.zeros(1)
        if self._has_rule:
            rule = nn.functional.one_hot(proposed.flatten()[index], self.choices).to(rows.dtype)
            inputs, prior = [rows, rule], PRIOR * rule
        own = self.encoder(torch.cat(inputs, dim=1))
        both = torch.cat([own, self._look_around(rows, own, present)], dim=1)
        return ParcelValues(index, self.actor(both) + prior, self.critic(both)[:, 0])

    def _look_around(
        self, rows: torch.Tensor, own: torch.Tensor, present: torch.Tensor
    ) -> torch.Tensor:
        """Return outputs (parcels, units) of attention over the parcels of the same surface.

        `rows` (parcels, features) are the parcels' rows, and `own` (parcels, units) the encoded
        rows. `present` (num_envs, rows) marks the rows of the tables that hold a parcel.
        """
        count = present.sum(dim=1)
        most = max(1, int(count.max()))
        surface = present.nonzero()[:, 0]
        place = (present.cumsum(dim=1) - 1)[present]
        units = own.shape[1]

        def packed(values: torch.Tensor) -> torch.Tensor:
            room = values.new_zeros(len(present), most, values.shape[1])
            return room.index_put((surface, place), values)

        bias = torch.zeros(1)
        if self.pair is not None:
            where = packed(rows[:, self._place] * self._scale)
            apart = where[:, None] - where[:, :, None]
            apart = apart.clamp(-torch.tensor(PAIR_RANGE), torch.tensor(PAIR_RANGE))
            pairs = self.pair(torch.cat([apart, apart[..., :2].square()], dim=3))
            bias = pairs.permute(0, 3, 1, 2)
        query, key, value = (
            packed(each).view(len(present), most, HEADS, -1).transpose(1, 2)
            for each in self.attend(own).chunk(3, dim=1)
        )
        score = query @ key.transpose(2, 3) / math.sqrt(units / HEADS) + bias
        there = torch.arange(most) < count[:, None]
        score = score.masked_fill(~there[:, None, None], -1e9)
        found = (score.softmax(dim=3) @ value).transpose(1, 2).flatten(2)
        gathered: torch.Tensor = found[surface, place]
        return gathered


def to_halves(choice: Integers, orientations: int) -> Integers:
    """Split a parcel's choice (...) into orientation indices (..., 2) of front and rear half."""
    return np.stack(np.divmod(choice, orientations), axis=-1)


class Proposer:
    """Computes the choices of the rule that a policy corrects, or zeros if the task has no rule."""

    def __init__(self, config: EnvConfig) -> None:
        prior = find_prior(config.task_name)
        self._rule = None if prior is None else prior.make(config.replace(actions="parcels"))
        self._orientations = len(config.chosen_orientations)

    def propose(self, tables: Any, memory: Any, fresh: Any) -> tuple[Integers, Any]:
        """Return the rule's choices (num_envs, rows) and the rule's new memory.

        If the task has no rule, return zeros and None. `memory` is the memory from the last call.
        `fresh` (num_envs,) marks new episodes.
        """
        if self._rule is None:
            return np.zeros(tables.shape[:2], dtype=np.int64), None
        actions, memory = self._rule.predict(tables, memory, fresh)
        halves = actions.reshape(*tables.shape[:2], HALVES)
        choice: Integers = halves[..., 0] * self._orientations + halves[..., 1]
        return choice, memory


def make_network(config: EnvConfig, hidden: tuple[int, ...]) -> ParcelNetwork:
    """Make an untrained network for the parcels of `config`. `hidden` lists the units per layer."""
    choices, has_rule = len(config.chosen_orientations), find_prior(config.task_name) is not None
    return ParcelNetwork(config.features, choices, hidden, has_rule)


def suited(own: EnvConfig, config: EnvConfig | None) -> EnvConfig:
    """Return `config`. If `config` is None, return `own`, the configuration of a policy's training.

    Raise a ValueError if `config` does not suit the policy.
    """
    if config is None:
        return own
    checks.one_of("task", config.task_name, (own.task_name,))
    checks.one_of("actions", config.actions, (own.actions,))
    checks.one_of("gate", config.stream_task.gate, (False,))
    if config.chosen_orientations != own.chosen_orientations:
        raise ValueError(
            f"orientations must be the card's, {own.chosen_orientations}, "
            f"got {config.chosen_orientations}"
        )
    return config


class ParcelMemory(NamedTuple):
    """Memory of a `ParcelPolicy`, e.g. each choice's expected count minus its actual count."""

    rule: Any
    due: Numbers  # (num_envs, rows, choices) sum of probabilities minus times that it was chosen
    since: Numbers  # (num_envs, rows) [s] time since entry at the last observation; 0: no parcel


class ParcelPolicy(TrainedPolicy):
    """A trained policy that decides for each parcel.

    Deterministic decisions follow the probabilities over time. In each control period the policy
    takes the choice that was made too rarely, compared with its probability. For example, if the
    probability of braking is 0.5, the policy brakes in every other period.
    """

    def __init__(self, network: ParcelNetwork, card: PolicyCard, config: EnvConfig) -> None:
        super().__init__(card, config)
        self._network = network
        self._proposer = Proposer(config)
        self._orientations = len(config.chosen_orientations)
        seen = columns(config.features)
        self._present: Column = seen.present
        self._time: Column | None = getattr(seen, TIME, None)

    def _predict(
        self, batch: Any, state: Any, episode_start: Any, *, deterministic: bool
    ) -> tuple[Any, Any]:
        fresh = is_fresh(len(batch), state, episode_start)
        memory = None
        if state is not None:  # the rule checks its own memory
            checks.instance("state", state, ParcelMemory, "one that predict returned")
            due = np.zeros((*batch.shape[:2], self._orientations**HALVES))
            checks.alike("state.due", state.due, due)
            checks.alike("state.since", state.since, due[..., 0])
            memory = state.rule
        proposed, memory = self._proposer.propose(batch, memory, fresh)
        probability, index = self.probabilities(batch, proposed)
        due, since = self._carry_over(state, fresh, batch, probability.shape[1])
        owed = due.reshape(-1, probability.shape[1])
        choice = np.zeros(len(owed), dtype=np.int64)
        if deterministic:
            owed[index] += probability
            choice[index] = owed[index].argmax(axis=1)
            owed[index, choice[index]] -= 1.0
        else:
            uniform = torch.rand(len(index), 1).numpy()
            choice[index] = (uniform > probability.cumsum(axis=1)[:, :-1]).sum(axis=1)
        halves = to_halves(choice.reshape(batch.shape[:2]), self._orientations)
        return halves.reshape(len(batch), -1), ParcelMemory(memory, due, since)

    @torch.no_grad()
    def probabilities(self, batch: Any, proposed: Integers) -> tuple[Numbers, Integers]:
        """Return probabilities (parcels, choices), and the row index of each parcel.

        `batch` (num_envs, rows, features) and `proposed` (num_envs, rows) are as in `forward`. Row
        indices (parcels,) count the rows of all tables, one table after the other.
        """
        tables = torch.from_numpy(np.ascontiguousarray(batch))
        found = self._network(tables, torch.from_numpy(proposed))
        return found.logits.double().softmax(dim=1).numpy(), found.row.numpy()

    def _carry_over(
        self, state: Any, fresh: Booleans, batch: Any, choices: int
    ) -> tuple[Numbers, Numbers]:
        """Return the fields `due` and `since` of the next `ParcelMemory`.

        A choice's `due` is the sum of the choice's probabilities, minus the number of times that
        the policy took the choice. For new parcels, `due` is 0. `since` is the time [s] since the
        parcel's entry. `state` is the last memory, or None. `choices` is the number of choices that
        a parcel has.
        """
        present = self._present.of(batch) > 0.5
        since = np.zeros(batch.shape[:2])
        due = np.zeros((*batch.shape[:2], choices))
        if self._time is not None:
            since = self._time.of(batch).astype(np.float64)
        if state is not None:
            stays = present & ~fresh[:, np.newaxis]
            if self._time is not None:
                stays &= since > state.since
            due[stays] = state.due[stays]
        return due, since


def build_parcels(
    card: PolicyCard, weights: Weights, own: EnvConfig, config: EnvConfig | None = None
) -> ParcelPolicy:
    """Build a `ParcelPolicy` for the environment `config`.

    If `config` is None, the policy is for `own`, the environment of the card.
    """
    network = load_weights(lambda: make_network(own, card.hidden), card.hidden, weights)
    return ParcelPolicy(network, card, suited(own, config))


HOLD = 2  # control periods for which the shared number is constant
NUMBERS = 4099  # size of the table of numbers, a prime
ROW_OFFSET = 97  # offset between the table's rows
CENTRE = len(OWN) - 3  # feature of a module: distance ahead of the parcel's centre


class LocalInputs(NamedTuple):
    """Observations of all modules under parcels, ordered by parcel."""

    row: Integers  # (parcels,) row among all rows of all environments
    passed: torch.Tensor  # (parcels, PASSED) features shared by the modules under each parcel
    env: Integers  # (modules,) environment
    module: Integers  # (modules,) index in the action
    parcel: torch.Tensor  # (modules,) index among the parcels
    own: torch.Tensor  # (modules, len(OWN))


def see_modules(view: ModuleView, tables: Singles) -> LocalInputs:
    """Return the observations of all modules under parcels.

    The array `tables` has a table for each environment, shape (num_envs, rows, features).
    """
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
    """An actor, which decides for modules, and a critic, which values parcels."""

    def __init__(self, choices: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self.actor = _perceptron((PASSED + len(OWN), *hidden, choices))
        self.critic = _perceptron((PASSED, *hidden, 1))

    def forward(self, passed: torch.Tensor, own: torch.Tensor) -> torch.Tensor:
        """Compute log probabilities (modules, choices) from features of parcels and of modules.

        `passed` (modules, PASSED) has features of each module's parcel. `own` (modules, len(OWN))
        has features of the module.
        """
        logits: torch.Tensor = self.actor(torch.cat([passed, own], dim=1))
        return logits.log_softmax(dim=1)

    def value(self, passed: torch.Tensor) -> torch.Tensor:
        """Compute expected returns (parcels,) from parcels' features, shape (parcels, PASSED)."""
        found: torch.Tensor = self.critic(passed)[:, 0]
        return found


def _perceptron(units: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, after in pairwise(units):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class LocalPolicy(TrainedPolicy):
    """A trained policy for slopes. The policy decides for each module under a parcel."""

    def __init__(self, network: LocalNetwork, card: PolicyCard, config: EnvConfig) -> None:
        super().__init__(card, config)
        self._network = network
        self._view = ModuleView(config)
        self._rest = find_rest(config)
        self._numbers = find_numbers()

    @torch.no_grad()
    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        seen = see_modules(self._view, batch)
        log_probability = self._network(seen.passed[seen.parcel], seen.own)
        number = self._agree(batch, seen.row) if deterministic else torch.rand(len(seen.row))
        choice = draw_choices(log_probability, seen.parcel, number)
        return fill(seen, choice.numpy(), len(batch), self._view.modules, self._rest), None

    def _agree(self, tables: Singles, row: Integers) -> torch.Tensor:
        """Return a random number per parcel (parcels,). A parcel's modules share this number.

        The number depends on the parcel's time on the surface and on the parcel's table row.
        """
        rows = tables.shape[1]
        since = ta.COLUMN.time.of(tables).reshape(-1)[row] / self._config.control_period
        place = (since / HOLD + 1e-3).astype(np.int64) + ROW_OFFSET * (row % rows)
        return torch.from_numpy(self._numbers[place % NUMBERS])


def find_numbers() -> Singles:
    """Return the constant table of random numbers (NUMBERS,) in [0, 1)."""
    return np.random.default_rng(0).random(NUMBERS, dtype=np.float32)


def fill(seen: LocalInputs, choice: Integers, num_envs: int, modules: int, rest: int) -> Integers:
    """Build actions (num_envs, modules). Modules in `seen` take `choice`, others take `rest`."""
    actions = np.full((num_envs, modules), rest)
    actions[seen.env, seen.module] = choice
    return actions


def build_local(
    card: PolicyCard, weights: Weights, own: EnvConfig, config: EnvConfig | None = None
) -> LocalPolicy:
    """Build a `LocalPolicy` for `config`; None means `own`, the environment of the card."""

    def make() -> LocalNetwork:
        return LocalNetwork(len(own.chosen_orientations), card.hidden)

    return LocalPolicy(load_weights(make, card.hidden, weights), card, suited(own, config))
