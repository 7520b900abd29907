"""Policy of parcels: one network with attention corrects what a rule proposes for each on a slope.

Each row of the table is a parcel. What it does depends on its own row and, by attention, on all
others of its surface, so that the number of parcels does not matter, nor their order. Before
learning, the policy is nearly the rule: residual policy learning (Silver et al. 2018).
"""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.task import HALVES

from .base import BatchController, Booleans, Integers, Numbers, is_fresh
from .library import HEADS, PolicyCard, check_heads
from .rules.sequencing import PassAndPark
from .rules.singulation import TimeSlots
from .rules.slopes import SlopeRule, make_memory

MOST = 5.0  # of a feature, one way or the other; what is farther looks the same
APART = (2.0, 1.4, 2.0)  # of two parcels, [m] along and across and [m/s], that differ at most
PAIR = 5  # numbers that say how two parcels lie to each other
PRIOR = 6.0  # logit of what the rule proposes, before learning: 0.96 of all choices
SMALL = 0.01  # [-] of the usual first weights of the last layer
RULES: dict[str, type[SlopeRule]] = {
    "singulate": TimeSlots,
    "merge": TimeSlots,
    "sequence": PassAndPark,
}


class ParcelValues(NamedTuple):
    """What a network says of the parcels that are there, a row each."""

    row: torch.Tensor  # (parcels,) among the rows of all environments
    logits: torch.Tensor  # (parcels, choices)
    value: torch.Tensor  # (parcels,) expected return


class ParcelNetwork(nn.Module):
    """Actor and critic of each parcel, with attention over those on its surface.

    Args:
        features: of a row of the table.
        orientations: to choose from, for each half of a parcel; a choice is of both together.
        hidden: (units,).
    """

    def __init__(self, features: int, orientations: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        check_heads(hidden)
        units = hidden[0]
        self.choices = orientations**HALVES
        self.encoder = nn.Sequential(
            nn.Linear(features + self.choices, units), nn.ReLU(), nn.Linear(units, units), nn.ReLU()
        )
        self.attend = nn.Linear(units, 3 * units)  # query, key and value
        self.pair = nn.Linear(PAIR, HEADS)  # how much two attend to each other by how they lie
        last = nn.Linear(units, self.choices)
        with torch.no_grad():
            last.weight.mul_(SMALL)
            last.bias.zero_()
        self.actor = nn.Sequential(nn.Linear(2 * units, units), nn.ReLU(), last)
        self.critic = nn.Sequential(nn.Linear(2 * units, units), nn.ReLU(), nn.Linear(units, 1))

    def forward(self, tables: torch.Tensor, proposed: torch.Tensor) -> ParcelValues:
        """Compute what each parcel may do.

        Args:
            tables: (num_envs, rows, features).
            proposed: (num_envs, rows) choice of the rule.
        """
        present = ta.COLUMN.present.of(tables) > 0.5
        index = present.flatten().nonzero()[:, 0]
        rows = tables.flatten(0, 1)[index].clamp(-MOST, MOST)
        rule = nn.functional.one_hot(proposed.flatten()[index], self.choices).to(rows.dtype)
        own = self.encoder(torch.cat([rows, rule], dim=1))
        both = torch.cat([own, self._look_around(rows, own, present)], dim=1)
        return ParcelValues(index, self.actor(both) + PRIOR * rule, self.critic(both)[:, 0])

    def _look_around(
        self, rows: torch.Tensor, own: torch.Tensor, present: torch.Tensor
    ) -> torch.Tensor:
        """Gather (parcels, units) from the parcels of the same surface, those that are there side
        by side: there are far fewer than rows.
        """
        count = present.sum(dim=1)
        most = max(1, int(count.max()))
        surface = present.nonzero()[:, 0]
        place = (present.cumsum(dim=1) - 1)[present]
        units = own.shape[1]

        def packed(values: torch.Tensor) -> torch.Tensor:
            room = values.new_zeros(len(present), most, values.shape[1])
            return room.index_put((surface, place), values)

        x, y, vx = ta.COLUMN.to_the_end, ta.COLUMN.offset, ta.COLUMN.forward_speed
        lie = torch.stack([-x.of(rows), y.of(rows), rows[:, vx.place]], dim=1)
        where = packed(lie)
        apart = where[:, None] - where[:, :, None]
        apart = apart.clamp(-torch.tensor(APART), torch.tensor(APART))
        bias = self.pair(torch.cat([apart, apart[..., :2].square()], dim=3)).permute(0, 3, 1, 2)
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
    """Turn choices (...) of both halves together into those of each (..., 2)."""
    return np.stack(np.divmod(choice, orientations), axis=-1)


def propose(
    rule: SlopeRule, tables: Any, memory: Any, fresh: Any, orientations: int
) -> tuple[Integers, Any]:
    """Return what a rule would choose for both halves together (num_envs, rows), and its memory."""
    actions, memory = rule.predict(tables, memory, fresh)
    halves = actions.reshape(*tables.shape[:2], HALVES)
    choice: Integers = halves[..., 0] * orientations + halves[..., 1]
    return choice, memory


def find_config(card: PolicyCard, config: EnvConfig | None) -> EnvConfig:
    """Return the environment that a policy on a slope is for, which its card must suit; by default
    the card's own.
    """
    usual = EnvConfig(card.task, **card.env_kwargs)
    own = usual if config is None else config
    checks.one_of("task", own.task_name, (card.task,))
    checks.one_of("actions", own.actions, (card.actions,))
    checks.one_of("gate", own.stream_task.gate, (False,))
    if own.chosen_orientations != usual.chosen_orientations:
        raise ValueError(
            f"orientations must be {usual.chosen_orientations}, those of the card, "
            f"got {own.chosen_orientations}"
        )
    return own


class SlopePolicy(BatchController):
    """A trained policy on a slope.

    Args:
        network: of the policy.
        card: of the environment that it learned in.
        config: of the environment; None: the card's.
    """

    def __init__(self, network: nn.Module, card: PolicyCard, config: EnvConfig | None) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        network.eval()
        self._config = find_config(card, config)
        self._shape = (None, len(self._config.features))
        self.card = card
        self.env_id = card.env_id
        self.env_kwargs = card.env_kwargs


class ParcelMemory(NamedTuple):
    """What a policy remembers: what it owes each parcel, and the rule's own memory."""

    rule: Any
    due: Numbers  # (num_envs, rows, choices) probabilities, less what was chosen
    since: Numbers  # (num_envs, rows) time since it entered, as seen last


class ParcelPolicy(SlopePolicy):
    """A trained policy of parcels.

    A parcel is braked by half, say, where it is braked every other control period. So the policy
    follows its probabilities over time, without chance: of all choices, the one is taken that is
    furthest behind its share.

    Args:
        config: of the environment; None: the card's.
    """

    def __init__(
        self, network: ParcelNetwork, card: PolicyCard, config: EnvConfig | None = None
    ) -> None:
        super().__init__(network, card, config)
        self._network = network
        self._orientations = len(self._config.chosen_orientations)
        self._rule = RULES[card.task](self._config)

    def _predict(
        self, batch: Any, state: Any, episode_start: Any, *, deterministic: bool
    ) -> tuple[Any, Any]:
        fresh = is_fresh(len(batch), state, episode_start)
        memory = None
        if state is not None:
            due = np.zeros((*batch.shape[:2], self._orientations**HALVES))
            like = ParcelMemory(make_memory(*batch.shape[:2]), due, due[..., 0])
            memory = checks.alike("state", state, like).rule
        proposed, memory = propose(self._rule, batch, memory, fresh, self._orientations)
        probability, index = self.probabilities(batch, proposed)
        due = _carry_over(state, fresh, batch, probability.shape[1])
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
        since = ta.COLUMN.time.of(batch).astype(np.float64)
        return halves.reshape(len(batch), -1), ParcelMemory(memory, due, since)

    @torch.no_grad()
    def probabilities(self, batch: Any, proposed: Integers) -> tuple[Numbers, Integers]:
        """Compute (parcels, choices) the probabilities, and the rows (parcels,) they are of."""
        tables = torch.from_numpy(np.ascontiguousarray(batch))
        found = self._network(tables, torch.from_numpy(proposed))
        return found.logits.double().softmax(dim=1).numpy(), found.row.numpy()


def _carry_over(state: Any, fresh: Booleans, batch: Any, choices: int) -> Numbers:
    """Return (num_envs, rows, choices) what is owed those parcels that are there still."""
    due = np.zeros((*batch.shape[:2], choices))
    if state is not None:
        stays = (ta.COLUMN.time.of(batch) > state.since) & (ta.COLUMN.present.of(batch) > 0.5)
        stays &= ~fresh[:, np.newaxis]
        due[stays] = state.due[stays]
    return due
