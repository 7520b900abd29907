"""What the policy of parcels learns from: rewards of each, over environments that begin anew."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from surface_gym import agents
from surface_gym.agents.evaluation.material_flow import NEVER_SEEN, SHAPES_SEED
from surface_gym.agents.learning import parcels
from surface_gym.agents.learning.config import ParcelsConfig, defaults
from surface_gym.agents.learning.runs import train
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.parcel import assortment
from surface_gym.registration import ON_SLOPES

TINY = ParcelsConfig(num_envs=6, n_steps=16, batch_size=32, n_epochs=1, hidden=(8,), steps=192)


@pytest.fixture(autouse=True)
def short(monkeypatch) -> None:
    monkeypatch.setattr(parcels, "DURATION", 4.0)


def surfaces(task: str = "merge", num_envs: int = 6) -> parcels.Surfaces:
    made = parcels.Surfaces(parcels.training_configs(replace(TINY, task=task)), num_envs)
    made.begin(np.random.default_rng(0))
    return made


@pytest.mark.parametrize("task", ON_SLOPES)
def test_a_policy_is_left_that_acts_in_its_task(task, tmp_path) -> None:
    assert train(replace(TINY, task=task), tmp_path).steps == 192
    config = EnvConfig(task, actions="parcels", duration=2.0)
    policy = agents.read(tmp_path)
    assert policy.card.task == task
    seen = np.zeros((2, *config.observation_space().shape), dtype=np.float32)
    assert policy.predict(seen)[0].shape == (2, config.action_kind.size)


@pytest.mark.parametrize("task", ON_SLOPES)
def test_learning_needs_no_shape_that_it_is_measured_on(task) -> None:
    measured = {each.base for each in assortment(NEVER_SEEN, SHAPES_SEED)}
    for config in parcels.training_configs(replace(TINY, task=task)):
        assert not measured & {each.base for each in config.task.parcels}


def test_a_parcel_earns_its_own_reward_and_a_share_of_the_others() -> None:
    made = surfaces()
    for _ in range(60):
        stepped = made.step(np.full((6, made.rows, 2), 3))
    batch = made.batches[0]
    there = batch.streams.present[0]
    terms = batch.parcels.terms.reshape(2, made.rows, -1)[0, :, : len(ta.PARCEL_TERMS)]
    own = np.where(there, terms @ list(parcels.WEIGHTS.values()), 0.0)
    assert not stepped.left[0].any()
    assert there.sum() > 1
    wanted = np.where(there, own + parcels.SHARED * (own.sum() - own), 0.0)
    np.testing.assert_allclose(stepped.reward[0], wanted, rtol=1e-12)


def test_rewards_of_rows_and_episodes_are_those_of_the_environment() -> None:
    """Whatever leaves or enters, all terms of an episode are counted, and each leaving once."""
    made = surfaces()
    left = np.zeros(6, dtype=np.int64)
    for _ in range(100):  # 4 s: one episode each
        stepped = made.step(np.full((6, made.rows, 2), 3))
        left += stepped.left.sum(axis=1)
    assert stepped.out_of_time.all()
    assert len(stepped.last) == 6
    assert len(made.infos) == 6
    for info in made.infos:
        assert info["episode"]["l"] == pytest.approx(4.0)
        assert info["episode"]["r"] == pytest.approx(sum(info["reward_terms"].values()))
    delivered = [
        info["reward_terms"]["right"] - info["reward_terms"]["wrong"] for info in made.infos
    ]
    assert left.tolist() == [round(each) for each in delivered]
    assert max(delivered) > 1.0
    assert all(batch.streams.clock.max() == 0.0 for batch in made.batches)


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
    rewards, left, step = [], [], made.step

    def watched(halves):
        stepped = step(halves)
        rewards.append(stepped.reward)
        left.append(stepped.left)
        return stepped

    made.step = watched
    tables, _, old = learner._roll_out()
    returns = old[3].reshape(96, 6, made.rows).numpy()
    present = (tables[..., ta.PRESENT] > 0.5).reshape(96, 6, made.rows).numpy()
    gone = np.stack(left)
    assert gone.any()
    wanted, ahead = np.zeros_like(returns), np.zeros_like(returns[0])
    for period in reversed(range(96)):
        ahead = np.where(gone[period], 0.0, ahead) + rewards[period]
        wanted[period] = ahead
    np.testing.assert_allclose(returns[present], wanted[present], atol=1e-5)


def test_only_the_critic_learns_at_first() -> None:
    learner = parcels.ParcelLearner(replace(TINY, task="merge"))
    learner.begin(0)
    samples = learner._roll_out()
    before = {name: each.clone() for name, each in learner._learning.named_parameters()}
    assert learner._step(*samples, critic_only=True) == pytest.approx(0.0, abs=1e-6)
    for name, each in learner._learning.named_parameters():
        assert torch.equal(each, before[name]) == (not name.startswith("critic"))
    learner._step(*samples, critic_only=False)
    assert learner._step(*samples, critic_only=False) > 0.0


def test_the_best_network_so_far_is_kept() -> None:
    learner = parcels.ParcelLearner(replace(TINY, task="merge"))
    weights = learner._learning.critic[0].weight
    kept = []
    for steps, score in ((0, 1.0), (parcels.CRITIC_FIRST * 96, 1.0), (10**6, 0.5), (10**6, 2.0)):
        learner.steps, learner._score = steps, score
        with torch.no_grad():
            weights += 1.0
        learner._rate = lambda _: None
        learner.begin(0)
        before = weights.clone()
        learner.learn(SimpleNamespace(add_episodes=lambda _: None))
        kept.append(torch.equal(learner.network.critic[0].weight, before))
    assert kept == [False, True, False, True]


@pytest.mark.parametrize("task", ON_SLOPES)
def test_defaults_are_of_each_task(task) -> None:
    assert defaults(task, "parcels").task == task


@pytest.mark.parametrize("given", [{"task": "sort"}, {"actions": "modules"}, {"zones": (8,)}])
def test_what_is_not_of_parcels_is_refused(given) -> None:
    (name,) = given
    with pytest.raises(ValueError, match=f"{name} must be"):
        replace(TINY, **given)
