"""Training of modules: samples with varying numbers of modules, the lab preset, and advantages."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from surface_gym import agents
from surface_gym.agents.learning.config import ModulesConfig, defaults
from surface_gym.agents.learning.modules import ModuleSamples
from surface_gym.agents.learning.ppo import compute_advantages
from surface_gym.agents.learning.runs import train
from surface_gym.agents.learning.sb3 import make_training_envs


def samples(counts: list[int], first: int) -> ModuleSamples:
    """Samples numbered from `first`; each module carries its sample's number."""
    number = torch.arange(first, first + len(counts))
    modules = number.repeat_interleave(torch.tensor(counts))
    return ModuleSamples(number, number, number, torch.tensor(counts), modules, modules, modules)


def test_selected_samples_keep_their_modules() -> None:
    whole = ModuleSamples.concatenate([samples([2, 0, 3], 0), samples([1, 4, 0], 3)])
    some = whole.select(np.array([4, 1, 2, 4]))
    assert some.observations.tolist() == [4, 1, 2, 4]
    assert some.count.tolist() == [4, 0, 3, 4]
    assert some.place.tolist() == [4, 4, 4, 4, 2, 2, 2, 4, 4, 4, 4]
    assert some.sample.tolist() == [0, 0, 0, 0, 2, 2, 2, 3, 3, 3, 3]


def test_it_learns_for_the_lab_from_more_features(tmp_path) -> None:
    lab = defaults("sort", "modules", preset="lab")
    assert isinstance(lab, ModulesConfig)
    small = replace(lab, steps=128, num_envs=8, n_steps=16, batch_size=64)
    assert train(small, tmp_path).steps == 128
    policy = agents.read(tmp_path)
    assert policy.card.observe == lab.observe
    envs = make_training_envs(small)
    envs.seed(0)
    actions, _ = policy.predict(np.asarray(envs.reset()))
    assert actions.shape == (8, 64)


@pytest.mark.parametrize("gae_lambda", [0.0, 0.9, 1.0])
def test_advantages_are_weighted_sums_of_temporal_differences(gae_lambda) -> None:
    rng = np.random.default_rng(0)
    shape = (6, 3)
    rewards, value, next_value = rng.normal(size=(3, *shape))
    ended = rng.random(shape) < 0.3
    gamma = 0.9
    given = map(torch.from_numpy, (rewards, ended, value, next_value))
    found = compute_advantages(*given, gamma, gae_lambda).numpy()
    delta = rewards + gamma * next_value - value
    for i in range(shape[1]):
        for period in range(shape[0]):
            total = 0.0
            for later in range(period, shape[0]):
                total += (gamma * gae_lambda) ** (later - period) * delta[later, i]
                if ended[later, i]:
                    break
            assert found[period, i] == pytest.approx(total, rel=1e-12, abs=1e-12)
