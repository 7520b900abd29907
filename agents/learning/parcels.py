"""PPO of parcels on a slope: one shared network that corrects the task's rule."""

from pathlib import Path

import numpy as np
import torch

from ..base import Integers, Singles
from ..parcel_policy import ParcelNetwork, make_network, to_halves
from .algorithms import ParcelsConfig
from .learner import train_learner
from .runs import OnProgress, TrainResult
from .slopes import RolloutData, SlopeLearner, SlopeObservations, Surfaces, training_configs


class ParcelLearner(SlopeLearner[ParcelNetwork]):
    """Training of the parcels' policy and value."""

    most_kl = 0.03

    def __init__(self, config: ParcelsConfig) -> None:
        configs = training_configs(config)
        surfaces = Surfaces(configs, config.num_envs)
        torch.manual_seed(config.seed)
        super().__init__(config, surfaces, make_network(configs[0], config.hidden))

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._surfaces.begin(self._rng)
        self._seen = self._surfaces.see()

    @torch.no_grad()
    def _decide(self, seen: SlopeObservations) -> tuple[Integers, Integers, Singles, Singles]:
        """Draw choices; return halves (num_envs, rows, 2), and data of all rows (num_envs x rows,).

        The data are choice, log probability and value.
        """
        found = self._learning(*map(torch.from_numpy, seen))
        log_probability = found.logits.log_softmax(dim=1)
        uniform = torch.from_numpy(self._rng.random((len(found.row), 1), dtype=np.float32))
        chosen = (uniform > log_probability.exp().cumsum(dim=1)[:, :-1]).sum(dim=1)
        choice, likely, value = (
            torch.zeros(seen.proposed.size, dtype=kind)
            for kind in (torch.int64, torch.float32, torch.float32)
        )
        choice[found.row] = chosen
        likely[found.row] = log_probability.gather(1, chosen[:, None])[:, 0]
        value[found.row] = found.value
        halves = to_halves(choice.numpy().reshape(seen.proposed.shape), self._surfaces.orientations)
        return halves, choice.numpy(), likely.numpy(), value.numpy()

    @torch.no_grad()
    def _roll_out(self) -> list[torch.Tensor]:
        """Collect tables (samples, rows, features), and data of their rows (samples, rows).

        The data are the rule's proposal, the choice, its log probability, the normalised advantage
        and the return.
        """
        surfaces = self._surfaces
        all_seen: list[SlopeObservations] = []
        chosen: list[Integers] = []
        likely: list[Singles] = []
        kept = RolloutData([], [], [], [])
        for _ in range(self._config.n_steps):
            seen = self._seen
            halves, choice, log_probability, value = self._decide(seen)
            if kept.value:
                kept.following[-1] = np.where(kept.ended[-1], kept.following[-1], value)
            stepped = surfaces.step(halves)
            self._seen = surfaces.see()
            all_seen.append(seen)
            chosen.append(choice)
            likely.append(log_probability)
            kept.value.append(value)
            kept.reward.append(stepped.reward.ravel())
            timed = stepped.out_of_time
            kept.ended.append((stepped.left | (stepped.jammed | timed)[:, np.newaxis]).ravel())
            after = np.zeros(stepped.left.shape, dtype=np.float32)
            if timed.any():  # a truncated episode could have continued
                last = SlopeObservations(stepped.last, seen.proposed[timed])
                after[timed] = self._decide(last)[3].reshape(last.proposed.shape)
            kept.following.append((after * ~stepped.left).ravel())
        value = self._decide(self._seen)[3]
        kept.following[-1] = np.where(kept.ended[-1], kept.following[-1], value)
        advantage, returns = self._compute_returns(kept)
        tables, proposed = map(np.concatenate, zip(*all_seen, strict=True))
        shape = proposed.shape
        returns, advantage = returns.reshape(shape), advantage.reshape(shape)
        there = advantage[self._learning.find_present(torch.from_numpy(tables)).numpy()]
        advantage = (advantage - there.mean()) / (there.std() + 1e-8)
        of_rows = (np.concatenate(chosen), np.concatenate(likely), advantage, returns)
        old = [torch.from_numpy(each.reshape(shape).astype(np.float32)) for each in of_rows]
        return [torch.from_numpy(tables), torch.from_numpy(proposed), *old]

    def _step(self, samples: list[torch.Tensor], critic_only: bool) -> float:
        tables, proposed, *old = samples
        found = self._learning(tables, proposed)
        of_parcels = tuple(each.flatten()[found.row] for each in old)
        return self._improve(found.logits.log_softmax(dim=1), found.value, of_parcels, critic_only)


def train_parcels(
    config: ParcelsConfig, folder: Path, on_progress: OnProgress = lambda *_: None
) -> TrainResult:
    """Train one policy for all parcels; see `train_learner`."""
    return train_learner(config, folder, on_progress, ParcelLearner)
