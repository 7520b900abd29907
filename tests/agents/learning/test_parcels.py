"""How the policy of parcels learns: from a return of each, the critic first."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from surface_gym import agents
from surface_gym.agents.learning import parcels, slopes
from surface_gym.agents.learning.algorithms import ParcelsConfig
from surface_gym.agents.learning.config import defaults
from surface_gym.agents.learning.runs import train
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from tests.environments import ON_SLOPES

TINY = ParcelsConfig(num_envs=6, n_steps=16, batch_size=32, n_epochs=1, hidden=(8,), steps=192)


@pytest.fixture(autouse=True)
def short(monkeypatch) -> None:
    monkeypatch.setattr(slopes, "DURATION", 4.0)


@pytest.mark.parametrize("task", ON_SLOPES)
def test_a_policy_is_left_that_acts_in_its_task(task, tmp_path) -> None:
    assert train(replace(TINY, task=task), tmp_path).steps == 192
    config = EnvConfig(task, actions="parcels", duration=2.0)
    policy = agents.read(tmp_path)
    assert policy.card.task == task
    seen = np.zeros((2, *config.observation_space().shape), dtype=np.float32)
    assert policy.predict(seen)[0].shape == (2, config.action_kind.size)


def test_returns_of_a_parcel_end_as_it_leaves() -> None:
    """With a critic of zeros and all weight on the far, a return is the sum of what is to come."""
    config = replace(TINY, task="merge", gamma=1.0, gae_lambda=1.0, n_steps=96)
    learner = parcels.ParcelLearner(config)
    for parameter in learner._learning.critic.parameters():
        torch.nn.init.zeros_(parameter)
    with torch.no_grad():
        learner._learning.actor[-1].bias[-1] = 20.0  # all roll, so that some leave
    learner.begin(0)
    made = learner._surfaces
    rewards, departed, step = [], [], made.step

    def watched(halves):
        stepped = step(halves)
        rewards.append(stepped.reward)
        departed.append(stepped.departed)
        return stepped

    made.step = watched
    tables, *_, returns = learner.roll_out()
    returns = returns.reshape(96, 6, made.rows).numpy()
    present = (tables[..., ta.COLUMN.present.place] > 0.5).reshape(96, 6, made.rows).numpy()
    gone = np.stack(departed)
    assert gone.any()
    wanted, ahead = np.zeros_like(returns), np.zeros_like(returns[0])
    for period in reversed(range(96)):
        ahead = np.where(gone[period], 0.0, ahead) + rewards[period]
        wanted[period] = ahead
    np.testing.assert_allclose(returns[present], wanted[present], atol=1e-5)


@pytest.mark.parametrize("task", ON_SLOPES)
def test_defaults_are_of_each_task(task) -> None:
    assert defaults(task, "parcels").task == task


@pytest.mark.parametrize("given", [{"task": "sort"}, {"actions": "modules"}])
def test_what_is_not_of_parcels_is_refused(given) -> None:
    (name,) = given
    with pytest.raises(ValueError, match=f"{name} must be"):
        replace(TINY, **given)
