"""What networks learn from: environments with exact sensors, cameras and other zones; targets of
double Q; choices of modules; and decisions of a schedule, each with what it cost.
"""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.utils import set_random_seed
from torch.nn.functional import smooth_l1_loss

from surface_gym import agents
from surface_gym.agents.learning import algorithms, sb3, schedules
from surface_gym.agents.learning.algorithms import DQNConfig, ModulesConfig, PPOConfig
from surface_gym.agents.learning.config import defaults
from surface_gym.agents.learning.learner import compute_advantages
from surface_gym.agents.learning.runs import train
from surface_gym.agents.learning.shared import ModuleLearner
from surface_gym.agents.scheduling.decisions import ABOUT, LEVELS, OPTION, TOKEN
from surface_gym.agents.scheduling.scheduler import entrance_bound
from surface_gym.randomisation import Randomisation
from surface_gym.registration import env_id
from surface_gym.sensors import Exact
from surface_gym.tasks import TASKS
from tests.machine.recorded import ESTIMATE

NUM_ENVS = 4


def filled(n_steps: int) -> sb3.DoubleDQN:
    """A model with some control periods remembered, its two networks apart."""
    config = DQNConfig(
        num_envs=NUM_ENVS, buffer_size=NUM_ENVS * 60, learning_starts=10**6, n_steps=n_steps,
        hidden=(8,),
    )  # fmt: skip
    model = sb3.make_model(config, sb3.make_mirrored_envs(config))
    assert isinstance(model, sb3.DoubleDQN)
    model.learn(40 * NUM_ENVS)
    with torch.no_grad():
        for parameter in model.q_net_target.parameters():
            parameter.add_(torch.randn_like(parameter))
    return model


def test_a_gradient_step_is_the_double_estimates() -> None:
    """The target is the slow copy's value of the action that the network chooses."""
    model = filled(n_steps=1)
    set_random_seed(0)
    batch = model.replay_buffer.sample(32)
    set_random_seed(0)
    with torch.no_grad():
        slow = model.q_net_target(batch.next_observations).numpy()
        fast = model.q_net(batch.next_observations).numpy()
    next_value = slow[np.arange(32), fast.argmax(axis=1)]
    assert (next_value < slow.max(axis=1) - 1e-6).any()  # it is not one network's opinion
    assert (next_value != fast.max(axis=1)).any()
    later = (1.0 - batch.dones.numpy()[:, 0]) * model.gamma * next_value
    target = torch.from_numpy(batch.rewards.numpy()[:, 0] + later).float()
    value = model.q_net(batch.observations)[torch.arange(32), batch.actions[:, 0].long()]
    loss = smooth_l1_loss(value, target).item()
    model.train(gradient_steps=1, batch_size=32)
    assert model.logger.name_to_value["train/loss"] == pytest.approx(loss, rel=1e-5)


def test_no_return_reaches_into_another_episode() -> None:
    model = filled(n_steps=3)
    buffer = model.replay_buffer
    last = buffer.pos - 1
    buffer.dones[last - 5 : last + 1] = 0.0
    buffer.timeouts[last - 5 : last + 1] = 0.0
    sb3.truncate_last(model)
    buffer.rewards[last + 1 : last + 4] = 1e6  # of environments started anew
    buffer.pos += 3
    several = buffer._get_samples(np.array([last - 1] * 8))
    assert several.rewards.abs().max() < 1e3
    np.testing.assert_allclose(several.discounts.numpy(), model.gamma**2, rtol=1e-6)
    assert not several.dones.any()  # cut off, not failed: the rest is asked of the network


@pytest.mark.usefixtures("uncompiled")
@pytest.mark.parametrize(
    ("task", "share"), [("slow", 0.0), ("slow", 1.0), *((task, 0.5) for task in TASKS)]
)
def test_a_share_has_a_camera(task, share) -> None:
    config = PPOConfig(task=task, num_envs=8, batch_size=64, camera_share=share)
    envs = sb3.make_mirrored_envs(config)
    config_of_each = envs.get_attr("config")
    exact = [env_config.sensors == Exact() for env_config in config_of_each]
    assert exact == [True] * round(8 * (1 - share)) + [False] * round(8 * share)
    for env_config, is_exact in zip(config_of_each, exact, strict=True):
        assert env_config.randomisation == (Randomisation() if is_exact else Randomisation(0.2))
        assert env_config.task == sb3.training_task(task)
    assert envs.observation_space == gym.make(env_id(task), actions="halves").observation_space


@pytest.mark.usefixtures("uncompiled")
def test_half_of_the_environments_with_exact_sensors_have_zones_of_other_lengths() -> None:
    config = PPOConfig(task="slow", num_envs=32, batch_size=64, camera_share=0.5, zones=(8, 24))
    lines = [each.chosen_line for each in sb3.make_mirrored_envs(config).get_attr("config")]
    assert [line.zone_columns for line in lines] == [16] * 8 + [8] * 4 + [24] * 4 + [16] * 16
    assert len({line.columns - line.zone_columns for line in lines}) == 1


@pytest.mark.usefixtures("uncompiled")
def test_environments_are_on_the_identified_surface(tmp_path) -> None:
    ESTIMATE.save(tmp_path / "estimate.json")
    config = PPOConfig(
        task="stop", preset="lab", num_envs=8, batch_size=64, estimate=tmp_path / "estimate.json"
    )
    plain = sb3.make_mirrored_envs(replace(config, estimate=None)).get_attr("config")
    found = sb3.make_mirrored_envs(config).get_attr("config")
    for each, other in zip(found, plain, strict=True):
        asked = ESTIMATE.adapt(other)
        for name in ("line", "sensors", "actuators", "randomisation"):
            assert getattr(each, name) == getattr(asked, name)
    assert {each.chosen_line.mu_max for each in found} == {ESTIMATE.values["mu_max"]}


def test_samples_keep_their_modules() -> None:
    config = ModulesConfig(num_envs=8, n_steps=12, batch_size=96, hidden=(8,))
    learner = ModuleLearner(config)
    with torch.no_grad():
        torch.nn.init.normal_(learner._learning.actor._apart.weight)  # modules differ
        learner.begin(0)
        *samples, present, log_prob, _, _ = learner.roll_out()
        chosen = torch.from_numpy(np.random.default_rng(0).integers(0, 96, 40))
        found = learner._evaluate([each[chosen] for each in samples])
        torch.testing.assert_close(found.log_prob, log_prob[chosen], atol=1e-5, rtol=1e-5)
        value = learner._learning.critic(samples[0][chosen])
        torch.testing.assert_close(found.value, value)
    assert present.all()
    assert len(log_prob.unique()) > 40
    assert (samples[3][chosen] == 0).any()  # some have no modules yet


def test_modules_learn_for_the_lab_from_more_features(tmp_path) -> None:
    lab = defaults("sort", "modules", preset="lab")
    assert isinstance(lab, ModulesConfig)
    small = replace(lab, steps=128, num_envs=8, n_steps=16, batch_size=64, camera_share=1.0)
    assert train(small, tmp_path).steps == 128
    policy = agents.read(tmp_path)
    assert policy.card.observe == lab.observe
    envs = sb3.make_training_envs(small)
    envs.seed(0)
    assert policy.predict(np.asarray(envs.reset()))[0].shape == (8, 64)


@pytest.mark.parametrize("gae_lambda", [0.0, 0.9, 1.0])
def test_advantages_are_weighted_sums_of_temporal_differences(gae_lambda) -> None:
    rng = np.random.default_rng(0)
    rewards, value, next_value = rng.normal(size=(3, 6, 3))
    ended, gamma = rng.random((6, 3)) < 0.3, 0.9
    given = map(torch.from_numpy, (rewards, ended, value, next_value))
    found = compute_advantages(*given, gamma, gae_lambda).numpy()
    delta = rewards + gamma * next_value - value
    for period, i in np.ndindex(6, 3):
        total = 0.0
        for later in range(period, 6):
            total += (gamma * gae_lambda) ** (later - period) * delta[later, i]
            if ended[later, i]:
                break
        assert found[period, i] == pytest.approx(total, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_drawn_lines_differ_and_can_be_scheduled(seed) -> None:
    config, other = (
        schedules.draw_config(np.random.default_rng(k), 0.04) for k in (seed, seed + 99)
    )
    assert config != other
    assert config.stream_task.gate
    assert entrance_bound(config) > 0.0


def test_who_comes_behind_is_to_blame_for_a_touch() -> None:
    touched = np.zeros((2, 4), dtype=np.bool_)
    touched[0, [1, 3]] = touched[1, 2] = True  # the other one of the second had touched before
    blame = np.zeros((2, 4))
    schedules.share_blame(touched, blame)
    assert blame.tolist() == [[0.0, schedules.IN_THE_WAY, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]]


def test_it_learns_how_many_touches_to_expect() -> None:
    learner = schedules.ScheduleLearner(
        algorithms.SchedulesConfig(hidden=(8, 8), learning_rate=0.01)
    )
    torch.manual_seed(0)
    count = 512
    option = torch.randn(count, 1, OPTION)
    touches = ((option[:, 0, 0] > 0.0) & (torch.rand(count) < 1.0 / 3.0)).float()
    samples = schedules.DecisionSamples(
        option, torch.zeros(count, 2, TOKEN), torch.ones(count, 2, dtype=torch.bool),
        torch.zeros(count, ABOUT), torch.randint(len(LEVELS), (count,)), touches,
    )  # fmt: skip
    for _ in range(200):
        learner._step(samples)
    with torch.no_grad():
        risk = learner.network(*samples[:4])[:, 0].exp()
    found = risk.gather(1, samples.level[:, None])[:, 0]
    assert found[option[:, 0, 0] > 0.3].mean() == pytest.approx(1.0 / 3.0, abs=0.1)
    assert found[option[:, 0, 0] < -0.3].mean() < 0.1
    assert (risk.diff(dim=1) <= 0.0).all()  # more clearance is never less safe
