"""What the policy of modules on a slope learns from: the rule first, then each parcel's reward."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from surface_gym import agents
from surface_gym.agents.learning import local, slopes
from surface_gym.agents.learning.algorithms import LocalConfig
from surface_gym.agents.learning.config import defaults
from surface_gym.agents.learning.runs import train
from surface_gym.config import EnvConfig
from tests.environments import ON_SLOPES

TINY = LocalConfig(num_envs=6, n_steps=16, batch_size=96, n_epochs=1, hidden=(8,), steps=192)


@pytest.fixture(autouse=True)
def short(monkeypatch) -> None:
    monkeypatch.setattr(local, "ROUNDS", ((30, 0.0, 2), (10, 0.9, 1)))
    monkeypatch.setattr(local, "BATCH", 200)
    monkeypatch.setattr(slopes, "DURATION", 4.0)


@pytest.mark.parametrize("task", ON_SLOPES)
def test_a_policy_is_left_that_acts_in_its_task(task, tmp_path) -> None:
    assert train(replace(TINY, task=task), tmp_path).steps == 192
    config = EnvConfig(task, actions="modules", duration=2.0)
    policy = agents.read(tmp_path)
    assert (policy.card.task, policy.card.actions) == (task, "modules")
    seen = np.zeros((2, *config.observation_space().shape), dtype=np.float32)
    assert policy.predict(seen)[0].shape == (2, config.action_kind.size)


def test_imitation_comes_near_to_the_rule(monkeypatch) -> None:
    monkeypatch.setattr(local, "ROUNDS", ((200, 0.0, 30),))
    learner = local.LocalLearner(replace(TINY, task="merge", hidden=(32,)))
    learner.begin(0)
    passed, own, asked = map(torch.cat, zip(*learner._watch_rule(80, 0.0), strict=True))
    share = torch.bincount(asked, minlength=4) / len(asked)
    blind = -(share * share.log()).sum()  # [nat] of one that sees nothing
    assert torch.nn.functional.nll_loss(learner._learning(passed, own), asked) < 0.8 * blind


def test_every_module_has_the_return_of_its_parcel() -> None:
    """With a critic of zeros and all weight on the far, it is the sum of what is to come."""
    config = replace(TINY, task="merge", gamma=1.0, gae_lambda=1.0, n_steps=64)
    learner = local.LocalLearner(config)
    for parameter in learner._learning.critic.parameters():
        torch.nn.init.zeros_(parameter)
    with torch.no_grad():
        learner._learning.actor[-1].bias[-1] = 20.0  # all roll, so that some leave
    learner._rng = np.random.default_rng(0)
    learner._number = learner._rng.random(learner._slots, dtype=np.float32)
    made = learner._surfaces
    made.begin(learner._rng)
    learner._seen = learner._see()
    rewards, departed, rows = [], [], [set(learner._seen.row.tolist())]
    step, see = made.step, learner._see

    def stepped(actions):
        found = step(actions)
        rewards.append(found.reward.ravel())
        departed.append(found.departed.ravel())
        return found

    def seen():
        found = see()
        rows.append(set(found.row.tolist()))
        return found

    made.step, learner._see = stepped, seen
    *_, returns = learner.roll_out()
    assert np.any(departed)
    wanted, ahead = [], np.zeros(learner._slots)
    for period in reversed(range(64)):
        ahead = np.where(departed[period], 0.0, ahead) + rewards[period]
        wanted += ahead[sorted(rows[period])].tolist()
    found = returns.numpy()
    assert np.abs(found[:, np.newaxis] - np.array(wanted)).min(axis=1).max() < 1e-5


@pytest.mark.parametrize("task", ON_SLOPES)
def test_defaults_are_of_each_task(task) -> None:
    assert defaults(task, "local").task == task


@pytest.mark.parametrize(
    "given",
    [{"task": "sort"}, {"actions": "parcels"}, {"split_probability": 2.0}],
)
def test_what_is_not_of_modules_on_a_slope_is_refused(given) -> None:
    (name,) = given
    with pytest.raises(ValueError, match=f"{name} must be"):
        replace(TINY, **given)
