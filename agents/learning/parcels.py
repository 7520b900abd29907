"""Shared-policy PPO per parcel: one network corrects the rule of its task, if there is one."""

from pathlib import Path

import numpy as np
import torch

from ..base import Integers, Numbers
from ..parcel_policy import ParcelNetwork, make_network, to_halves
from .algorithms import ParcelsConfig
from .learner import train_learner
from .runs import OnProgress, TrainResult
from .shared import Decision, Evaluation, SlotOutcome, gather, mean_entropy
from .slopes import SlopeObservations, StreamLearner, Surfaces, training_configs


class ParcelLearner(StreamLearner[ParcelNetwork, ParcelsConfig]):
    """Training of the parcels' policy and value; a sample is a whole table."""

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

    def _decide(self) -> Decision:
        tables, proposed = map(torch.from_numpy, self._seen)
        found = self._learning(tables, proposed)
        log_probability = found.logits.log_softmax(dim=1)
        uniform = torch.from_numpy(self._rng.random((len(found.row), 1), dtype=np.float32))
        chosen = (uniform > log_probability.exp().cumsum(dim=1)[:, :-1]).sum(dim=1)
        choice = torch.zeros(proposed.numel(), dtype=torch.int64)
        likely, value = torch.zeros(proposed.numel()), torch.zeros(proposed.numel())
        choice[found.row] = chosen
        likely[found.row] = gather(log_probability, chosen)
        value[found.row] = found.value
        choice = choice.reshape(proposed.shape)
        return Decision(
            to_halves(choice.numpy(), self._surfaces.orientations),
            value.numpy(),
            (tables, proposed, choice),
            np.arange(proposed.numel()).reshape(proposed.shape),
            self._learning.find_present(tables),
            likely.reshape(proposed.shape),
        )

    def _move(self, actions: Integers) -> SlotOutcome:
        period = self._surfaces.step(actions)
        timed = period.out_of_time
        last = self._compute_values(SlopeObservations(period.last, self._seen.proposed[timed]))
        self._seen = self._surfaces.see()
        return self._outcome(period, last.reshape(-1, self._surfaces.rows))

    def _value(self) -> Numbers:
        return self._compute_values(self._seen)

    def _compute_values(self, seen: SlopeObservations) -> Numbers:
        """Return the expected returns of all rows; 0 in empty rows."""
        value = np.zeros(seen.proposed.size)
        if value.size:
            found = self._learning(*map(torch.from_numpy, seen))
            value[found.row.numpy()] = found.value.numpy()
        return value

    def _evaluate(self, samples: list[torch.Tensor]) -> Evaluation:
        tables, proposed, choice = samples
        found = self._learning(tables, proposed)
        log_probability = found.logits.log_softmax(dim=1)
        log_prob = gather(log_probability, choice.flatten()[found.row])
        return Evaluation(log_prob, found.value, mean_entropy(log_probability))


def train_parcels(
    config: ParcelsConfig, folder: Path, on_progress: OnProgress = lambda *_: None
) -> TrainResult:
    """Train one policy for all parcels; see `train_learner`."""
    return train_learner(config, folder, on_progress, ParcelLearner)
