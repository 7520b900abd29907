"""Shared-policy PPO per module on a slope; a module sees itself and its neighbours' messages.

Training begins with imitation of the task's rule. Every module under a parcel gets the parcel's
reward, and is a sample of its own. Modules under a parcel share one random draw, so they make the
same choice, and PPO can credit their joint action.
"""

from pathlib import Path

import numpy as np
import torch

from surface_gym.flow.base import HALVES
from surface_gym.flow.module_view import ModuleView

from ..base import Integers, Numbers
from ..local_policy import CENTRE, HOLD, LocalInputs, LocalNetwork, fill, find_rest, see_modules
from ..module_policy import GROUPS, draw_choices, draw_groups
from ..parcel_policy import to_halves
from .algorithms import LocalConfig
from .learner import train_learner
from .runs import OnProgress, TrainResult
from .shared import Decision, Evaluation, SlotOutcome, gather, mean_entropy, shuffle
from .slopes import StreamLearner, Surfaces, training_configs

# Rounds of imitation (DAgger): control periods, share of environments in which the network acts
# while the rule labels, and passes over all samples so far.
ROUNDS = ((600, 0.0, 6), *(((500, 0.9, 4),) * 5), (500, 0.9, 12))
LEARNED = 0.25  # [-] share of a rollout's modules that PPO uses: modules of a parcel are alike
KEPT = 0.15  # [-] share of modules kept for imitation, every other control period
BATCH = 6000  # modules of a step of imitation
RATE = 2e-3  # learning rate of imitation; it falls to 0 in the last round


class LocalLearner(StreamLearner[LocalNetwork, LocalConfig]):
    """Training of the modules' policy and the parcels' value, in one network."""

    most_kl = 0.01

    def __init__(self, config: LocalConfig) -> None:
        configs = training_configs(config)
        surfaces = Surfaces(configs, config.num_envs)
        self._view = ModuleView(configs[0])
        self._rest = find_rest(configs[0])
        torch.manual_seed(config.seed)
        super().__init__(config, surfaces, LocalNetwork(surfaces.orientations, config.hidden))

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._number = self._rng.random(self._slots, dtype=np.float32)
        if self.steps == 0:
            self._imitate()
        self._surfaces.begin(self._rng)
        self._seen = self._see()

    def _see(self) -> LocalInputs:
        return see_modules(self._view, self._surfaces.see().tables)

    def _imitate(self) -> None:
        """Imitate the rule: first in its own episodes, then in the network's (DAgger)."""
        optimiser = torch.optim.Adam(self._learning.actor.parameters(), RATE)
        shown: list[tuple[torch.Tensor, ...]] = []
        for number, (periods, own, passes) in enumerate(ROUNDS, start=1):
            shown += self._watch_rule(periods, own)
            passed, of_modules, asked = map(torch.cat, zip(*shown, strict=True))
            for done in range(passes):
                if number == len(ROUNDS):
                    optimiser.param_groups[0]["lr"] = RATE * (1.0 - done / passes)
                for chosen in shuffle(self._rng, len(asked), BATCH):
                    found = self._learning(passed[chosen], of_modules[chosen])
                    loss = torch.nn.functional.nll_loss(found, asked[chosen])
                    optimiser.zero_grad()
                    torch.autograd.backward(loss)
                    optimiser.step()
        self._surfaces.infos.clear()

    def _watch_rule(self, periods: int, own: float) -> list[tuple[torch.Tensor, ...]]:
        """Collect observations of some modules, labelled with the rule's choices."""
        surfaces, rng = self._surfaces, self._rng
        surfaces.begin(rng)
        found: list[tuple[torch.Tensor, ...]] = []
        acts = rng.random(surfaces.num_envs) < own
        for period in range(periods):
            tables, proposed = surfaces.see()
            seen = see_modules(self._view, tables)
            halves = to_halves(proposed, surfaces.orientations).reshape(-1, HALVES)
            behind = (seen.own[:, CENTRE] < 0.0).numpy().astype(np.int64)
            choice = halves[seen.row[seen.parcel.numpy()], behind]
            if period % 2 == 0:
                kept = torch.from_numpy(np.flatnonzero(rng.random(len(choice)) < KEPT))
                asked = torch.from_numpy(choice)[kept]
                found.append((seen.passed[seen.parcel[kept]], seen.own[kept], asked))
            if own > 0.0:
                drawn = self._draw(seen, split=False)[0].numpy()
                choice = np.where(acts[seen.env], drawn, choice)
            surfaces.step(fill(seen, choice, surfaces.num_envs, self._view.modules, self._rest))
        return found

    @torch.no_grad()
    def _draw(self, seen: LocalInputs, split: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw choices (modules,), and return them with their log probabilities."""
        rng, parcels = self._rng, len(seen.row)
        new = rng.random(self._slots) < 1.0 / HOLD
        self._number[new] = rng.random(int(new.sum()), dtype=np.float32)
        number = rng.random(GROUPS * parcels, dtype=np.float32)
        number[::GROUPS] = self._number[seen.row]
        probability = self._config.split_probability if split else 0.0
        where = seen.own[:, CENTRE : CENTRE + 2].numpy()
        group = draw_groups(seen.parcel.numpy(), where, parcels, probability, rng)
        log_probability = self._learning(seen.passed[seen.parcel], seen.own)
        choice = draw_choices(log_probability, torch.from_numpy(group), torch.from_numpy(number))
        return choice, gather(log_probability, choice)

    def _decide(self) -> Decision:
        seen = self._seen
        value = self._compute_values(seen, self._slots)
        choice, likely = self._draw(seen)
        drawn = self._rng.random(len(choice)) < LEARNED
        some = torch.from_numpy(np.flatnonzero(drawn))
        parcel = seen.parcel[some]
        return Decision(
            fill(seen, choice.numpy(), self._surfaces.num_envs, self._view.modules, self._rest),
            value,
            (seen.passed[parcel], seen.own[some], choice[some]),
            seen.row[parcel.numpy()],
            torch.ones(len(some), dtype=torch.bool),
            likely[some],
        )

    def _move(self, actions: Integers) -> SlotOutcome:
        period = self._surfaces.step(actions)
        self._seen = self._see()
        count = len(period.last)
        last = np.zeros((count, self._surfaces.rows))
        if count:
            seen = see_modules(self._view, period.last)
            last = self._compute_values(seen, last.size).reshape(last.shape)
        return self._outcome(period, last)

    def _value(self) -> Numbers:
        return self._compute_values(self._seen, self._slots)

    @torch.no_grad()
    def _compute_values(self, seen: LocalInputs, rows: int) -> Numbers:
        """Return expected returns (rows,) of parcels; 0 in empty rows."""
        value = np.zeros(rows)
        value[seen.row] = self._learning.value(seen.passed).numpy()
        return value

    def _evaluate(self, samples: list[torch.Tensor]) -> Evaluation:
        passed, own, choice = samples
        log_probability = self._learning(passed, own)
        value = self._learning.value(passed)
        return Evaluation(gather(log_probability, choice), value, mean_entropy(log_probability))


def train_local(
    config: LocalConfig, folder: Path, on_progress: OnProgress = lambda *_: None
) -> TrainResult:
    """Train one policy for all modules on a slope; see `train_learner`."""
    return train_learner(config, folder, on_progress, LocalLearner)
