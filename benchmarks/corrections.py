"""PPO that corrects the rule "patterns" through a mouth in the lab: residual policy learning.

Shared-policy PPO corrects the rule (Silver et al. 2018). An action shifts the speeds that the rule
observes of a parcel, for `HOLD` control periods. So the rule drives the parcel at another speed.
Before training, most actions shift nothing.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import torch

from surface_gym.agents.base import Integers, Numbers, Singles
from surface_gym.agents.evaluation.method import all_methods
from surface_gym.agents.evaluation.scenario import WHOLE
from surface_gym.agents.evaluation.streams import StreamScenario, measure_stream
from surface_gym.agents.learning import slopes
from surface_gym.agents.learning.algorithms import ParcelsConfig
from surface_gym.agents.rules.patterns import Patterns
from surface_gym.agents.scheduling.scheduler import begin_streams
from surface_gym.agents.slope_policy import ParcelNetwork, to_halves
from surface_gym.flow.take_away import COLUMN
from surface_gym.state import RUNNING

HOLD = 5  # control periods
ALONG = np.array([0.0, -0.15, 0.15])  # [m/s] added to the speed along the slope that the rule wants
ASIDE = np.array([0.0, 0.3, -0.3])  # [m/s] added to the speed across the slope
SHIFTED = (COLUMN.forward_speed, COLUMN.lateral_speed)
EASIER = 1.5  # decrease of the rule's initial logit (`slope_policy.PRIOR`), for exploration
SEED = 424_242  # of the compared streams


def shift(tables: Singles, corrections: Integers, since: float) -> Singles:
    """Return tables (num_envs, rows, features) with the parcels' speeds shifted by corrections.

    Args:
        corrections: (num_envs, rows, 2) indices in `ALONG` and `ASIDE`.
        since: [s] time since the corrections were chosen; later parcels are not shifted.
    """
    shifted, old = tables.copy(), COLUMN.time.of(tables) >= since
    for k, (column, by) in enumerate(zip(SHIFTED, (ALONG, ASIDE), strict=True)):
        shifted[..., column.place] -= old * by[corrections[..., k]] / column.scale
    return shifted


class CorrectedSurfaces(slopes.Surfaces):
    """Environments in which the rule acts; actions are corrections of the rule."""

    def __init__(self, configs: Any, num_envs: int) -> None:
        super().__init__(configs, num_envs)
        self.orientations = len(ALONG)
        self._acting = [Patterns(config) for config in configs]

    def see(self) -> slopes.SlopeObservations:
        tables = np.concatenate([batch.observation for batch in self.batches])
        return slopes.SlopeObservations(tables, np.zeros(tables.shape[:2], dtype=np.int64))

    def step(self, halves: Integers) -> slopes.SlopeStep:
        """Step all environments by `HOLD` control periods with corrections (num_envs, rows, 2)."""
        reward, over = np.zeros((self.num_envs, self.rows)), np.zeros(self.num_envs, dtype=np.bool_)
        departed = reward > 0.0
        parts = np.split(halves, np.cumsum([batch.num_envs for batch in self.batches[:-1]]))
        for period in range(HOLD):
            departed = departed | over[:, np.newaxis]
            actions = []
            for k, (rule, batch) in enumerate(zip(self._acting, self.batches, strict=True)):
                table = shift(batch.observation, parts[k], period * batch.config.control_period)
                action, self._memories[k] = rule.predict(table, self._memories[k], self._fresh[k])
                actions.append(action)
            found = super().step(np.concatenate(actions))
            reward += np.where(departed, 0.0, found.reward)
            departed, over = departed | found.departed, found.jammed | found.out_of_time
        return found._replace(reward=reward, departed=departed)


class CorrectionLearner(slopes.ParcelLearner):
    """Training of the corrections, in the lab."""

    critic_first = 4

    def __init__(self, config: ParcelsConfig) -> None:
        lab = slopes.training_configs(config)[:2]
        configs = [each.replace(actions="modules", max_parcels=32) for each in lab]
        torch.manual_seed(config.seed)
        network = ParcelNetwork(configs[0].features, len(ALONG), config.hidden)
        with torch.no_grad():
            dict(network.named_parameters())["actor.2.bias"][0] = -EASIER
        surfaces = CorrectedSurfaces(configs, config.num_envs)
        slopes.StreamLearner.__init__(self, config, surfaces, network)


def train(rollouts: int, seed: int, on_rollout: Callable[[], Any]) -> torch.nn.Module:
    """Train corrections of the rule, and return the network."""
    torch.set_num_threads(1)
    config = ParcelsConfig(
        seed=seed, num_envs=32, n_steps=32, batch_size=256, n_epochs=4, learning_rate=2e-3,
        gamma=0.97, ent_coef=0.0, steps=32 * 32 * rollouts,
    )  # fmt: skip
    learner, curve = CorrectionLearner(config), cast(Any, SimpleNamespace(add_episodes=len))
    learner.begin(seed)
    while learner.steps < config.steps:
        learner.learn(curve)
        on_rollout()
    return learner.network


def play(
    network: torch.nn.Module | None, streams: int, on_progress: Callable[[float], Any]
) -> tuple[Numbers, int, float]:
    """Run streams with the rule, which the network corrects; None: the rule alone.

    Args:
        on_progress: called after each control period with its share [-] of the duration.

    Returns:
        Rates (streams,) [parcels/h], number of jams, and share of corrected decisions.
    """
    method = next(each for each in all_methods("singulate") if each.name == "patterns")
    scenario = StreamScenario("singulate", "lab", WHOLE, "mouth of 0.6 m, 10 deg")
    config = scenario.config(method, scenario.offer.rates[0])
    rule, batch, state = Patterns(config), begin_streams(config, streams, SEED), None
    corrections, period, shares = np.zeros((streams, config.rows, 2), dtype=np.int64), 0, [0.0]
    torch.manual_seed(SEED)
    while (batch.outcome == RUNNING).any():
        seen = batch.observation
        if network is not None and period % HOLD == 0:
            with torch.no_grad():
                nothing = torch.zeros(seen.shape[:2], dtype=torch.int64)
                found = network(torch.from_numpy(seen.copy()), nothing)
            noise = -torch.log(-torch.log(torch.rand_like(found.logits)))  # Gumbel's
            choice = (found.logits + noise).argmax(dim=1).numpy()
            shares.append(np.count_nonzero(choice) / max(1, choice.size))
            corrections[:] = 0
            corrections.reshape(-1, 2)[found.row.numpy()] = to_halves(choice, len(ALONG))
        table = shift(seen, corrections, period % HOLD * config.control_period)
        action, state = rule.predict(table, state, np.full(streams, period == 0))
        batch.step(config.action_kind.commands(action, streams))
        period += 1
        on_progress(config.control_period / config.stream_task.duration)
    rows = measure_stream(batch)
    rates = np.array([row["parcels_per_hour"] for row in rows])
    return rates, sum(row["jam"] for row in rows), float(np.mean(shares))
