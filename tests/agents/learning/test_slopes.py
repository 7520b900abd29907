"""What agents on slopes learn from: rewards of each parcel, over environments that begin anew."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from surface_gym import agents
from surface_gym.agents.evaluation.streams import NEVER_SEEN, SHAPES_SEED
from surface_gym.agents.learning import shared, slopes
from surface_gym.agents.learning.algorithms import LocalConfig, ParcelsConfig
from surface_gym.agents.learning.runs import train
from surface_gym.agents.learning.slopes import LocalLearner, ParcelLearner
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.parcel import assortment
from tests.environments import ON_SLOPES

TINY = ParcelsConfig(num_envs=6, n_steps=16, batch_size=32, n_epochs=1, hidden=(8,), steps=192)
LOCAL = LocalConfig(num_envs=6, n_steps=16, batch_size=96, n_epochs=1, hidden=(8,), steps=192)


@pytest.fixture(autouse=True)
def short(monkeypatch) -> None:
    monkeypatch.setattr(slopes, "DURATION", 4.0)
    monkeypatch.setattr(slopes, "ROUNDS", ((30, 0.0, 2), (10, 0.9, 1)))
    monkeypatch.setattr(slopes, "BATCH", 200)


@pytest.mark.parametrize("config", [TINY, LOCAL], ids=["parcels", "local"])
@pytest.mark.parametrize("task", ON_SLOPES)
def test_a_policy_is_left_that_acts_in_its_task(task, config, tmp_path) -> None:
    assert train(replace(config, task=task), tmp_path).steps == 192
    policy = agents.read(tmp_path)
    assert (policy.card.task, policy.card.actions) == (task, config.actions)
    env_config = EnvConfig(task, actions=config.actions, duration=2.0)
    seen = np.zeros((2, *env_config.observation_space().shape), dtype=np.float32)
    assert policy.predict(seen)[0].shape == (2, env_config.action_kind.size)


def surfaces(task: str = "merge", num_envs: int = 6) -> slopes.Surfaces:
    made = slopes.Surfaces(slopes.training_configs(replace(TINY, task=task)), num_envs)
    made.begin(np.random.default_rng(0))
    return made


@pytest.mark.parametrize("task", ON_SLOPES)
def test_learning_needs_no_shape_that_it_is_measured_on(task) -> None:
    measured = {each.base for each in assortment(NEVER_SEEN, SHAPES_SEED)}
    for config in slopes.training_configs(replace(TINY, task=task)):
        assert not measured & {each.base for each in config.task.parcels}


def test_a_parcel_earns_its_own_reward_and_a_share_of_the_others() -> None:
    made = surfaces()
    for _ in range(60):
        stepped = made.step(np.full((6, made.rows, 2), 3))
    batch = made.batches[0]
    there = batch.streams.present[0]
    terms = batch.parcels.terms.reshape(2, made.rows, -1)[0, :, : len(ta.PARCEL_TERMS)]
    own = np.where(there, terms @ [1.0, 2.0, 5.0, 1.0, 5.0], 0.0)  # right, wrong, touch, way, time
    assert not stepped.departed[0].any()
    assert there.sum() > 1
    wanted = np.where(there, own + slopes.SHARED * (own.sum() - own), 0.0)
    np.testing.assert_allclose(stepped.reward[0], wanted, rtol=1e-12)


def test_rewards_of_rows_and_episodes_are_those_of_the_environment() -> None:
    made = surfaces()
    left = np.zeros(6, dtype=np.int64)
    for _ in range(100):  # 4 s: one episode each
        stepped = made.step(np.full((6, made.rows, 2), 3))
        left += stepped.departed.sum(axis=1)
    assert stepped.out_of_time.all()
    assert len(stepped.last) == 6
    assert len(made.infos) == 6
    for info in made.infos:
        assert info["episode"]["l"] == pytest.approx(4.0)
        assert info["episode"]["r"] == pytest.approx(sum(info["reward_terms"].values()))
    delivered = [
        info["reward_terms"]["correct"] - info["reward_terms"]["wrong"] for info in made.infos
    ]
    assert left.tolist() == [round(each) for each in delivered]
    assert max(delivered) > 1.0
    assert all(batch.streams.clock.max() == 0.0 for batch in made.batches)


def test_where_nothing_leaves_for_long_an_episode_ends_as_a_jam(monkeypatch) -> None:
    monkeypatch.setattr(slopes, "STALLED", 0.99)
    made = surfaces()
    brake = np.zeros((6, made.rows, 2), dtype=np.int64)
    periods = round(1.0 / made.batches[0].config.control_period)
    steps = [made.step(brake) for _ in range(periods)]
    assert not any(each.jammed.any() for each in steps[:-1])
    assert steps[-1].jammed.all()
    assert not steps[-1].departed.any()
    assert len(made.infos) == 6
    assert all(batch.streams.clock.max() == 0.0 for batch in made.batches)


@pytest.mark.parametrize(("learner", "config"), [(ParcelLearner, TINY), (LocalLearner, LOCAL)])
def test_only_the_critic_learns_at_first(learner, config) -> None:
    made = learner(replace(config, task="merge"))
    made.begin(0)
    samples = made.roll_out()
    before = {name: each.clone() for name, each in made._learning.named_parameters()}
    assert made.step(samples, critic_only=True) == pytest.approx(0.0, abs=1e-6)
    for name, each in made._learning.named_parameters():
        assert torch.equal(each, before[name]) == (not name.startswith("critic"))
    made.step(samples, critic_only=False)
    assert made.step(samples, critic_only=False) > 0.0


@pytest.mark.parametrize(("learner", "config"), [(ParcelLearner, TINY), (LocalLearner, LOCAL)])
def test_the_best_network_so_far_is_kept(learner, config, monkeypatch) -> None:
    monkeypatch.setattr(shared, "SMOOTH", 1.0)  # a rollout changes no score
    made = learner(replace(config, task="merge"))
    weights = made._learning.critic[0].weight
    kept = []
    for steps, score in ((0, 1.0), (learner.critic_first * 96, 1.0), (10**6, 0.5), (10**6, 2.0)):
        made.steps, made._score = max(1, steps), score  # 0: it would imitate the rule first
        with torch.no_grad():
            weights += 1.0
        made.begin(0)
        before = weights.clone()
        made.learn(SimpleNamespace(add_episodes=lambda _: None))
        kept.append(torch.equal(made.network.critic[0].weight, before))
    assert kept == [False, True, False, True]


def test_returns_of_a_parcel_end_as_it_leaves() -> None:
    """With a critic of zeros and all weight on the far, a return is the sum of what is to come."""
    config = replace(TINY, task="merge", gamma=1.0, gae_lambda=1.0, n_steps=96)
    learner = ParcelLearner(config)
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


def test_imitation_comes_near_to_the_rule(monkeypatch) -> None:
    monkeypatch.setattr(slopes, "ROUNDS", ((200, 0.0, 30),))
    learner = LocalLearner(replace(LOCAL, task="merge", hidden=(32,)))
    learner.begin(0)
    passed, own, asked = map(torch.cat, zip(*learner._watch_rule(80, 0.0), strict=True))
    share = torch.bincount(asked, minlength=4) / len(asked)
    blind = -(share * share.log()).sum()  # [nat] of one that sees nothing
    assert torch.nn.functional.nll_loss(learner._learning(passed, own), asked) < 0.8 * blind


def test_every_module_has_the_return_of_its_parcel() -> None:
    """With a critic of zeros and all weight on the far, it is the sum of what is to come."""
    config = replace(LOCAL, task="merge", gamma=1.0, gae_lambda=1.0, n_steps=64)
    learner = LocalLearner(config)
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
