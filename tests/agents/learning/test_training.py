"""What networks learn from: environments with exact sensors, cameras and other zones; targets of
double Q; samples of modules; and slots, each of which follows one parcel through a flow.
"""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.utils import set_random_seed
from torch.nn.functional import smooth_l1_loss

from surface_gym import agents
from surface_gym.agents.base import SIDE
from surface_gym.agents.learning import sb3
from surface_gym.agents.learning.config import DQNConfig, ModulesConfig, PPOConfig, defaults
from surface_gym.agents.learning.modules import ModuleSamples
from surface_gym.agents.learning.parcels import SlotVecEnv, densest_stream, training_env_config
from surface_gym.agents.learning.ppo import compute_advantages
from surface_gym.agents.learning.runs import train
from surface_gym.agents.library import WEIGHTS
from surface_gym.agents.rules.streams import StreamEventRule
from surface_gym.config import EnvConfig
from surface_gym.flow.task import PRESENT, WAITS
from surface_gym.randomisation import Randomisation
from surface_gym.registration import env_id
from surface_gym.sensors import Exact
from surface_gym.tasks import TASKS
from tests.agents.learning.test_runs import RUNS

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


def test_half_of_the_environments_with_exact_sensors_have_zones_of_other_lengths() -> None:
    config = PPOConfig(task="slow", num_envs=32, batch_size=64, camera_share=0.5, zones=(8, 24))
    lines = [each.chosen_line for each in sb3.make_mirrored_envs(config).get_attr("config")]
    assert [line.zone_columns for line in lines] == [16] * 8 + [8] * 4 + [24] * 4 + [16] * 16
    assert len({line.columns - line.zone_columns for line in lines}) == 1


def samples(counts: list[int], first: int) -> ModuleSamples:
    """Samples numbered from `first`; each module carries its sample's number."""
    number = torch.arange(first, first + len(counts))
    modules = number.repeat_interleave(torch.tensor(counts))
    return ModuleSamples(number, number, number, torch.tensor(counts), modules, modules, modules)


def test_selected_samples_keep_their_modules() -> None:
    whole = ModuleSamples.concatenate([samples([2, 0, 3], 0), samples([1, 4, 0], 3)])
    some = whole.select(np.array([4, 1, 2, 4]))
    assert (some.observations.tolist(), some.count.tolist()) == ([4, 1, 2, 4], [4, 0, 3, 4])
    assert some.place.tolist() == [4, 4, 4, 4, 2, 2, 2, 4, 4, 4, 4]
    assert some.sample.tolist() == [0, 0, 0, 0, 2, 2, 2, 3, 3, 3, 3]


def test_modules_learn_for_the_lab_from_more_features(tmp_path) -> None:
    lab = defaults("sort", "modules", preset="lab")
    assert isinstance(lab, ModulesConfig)
    small = replace(lab, steps=128, num_envs=8, n_steps=16, batch_size=64)
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


def test_a_slot_follows_a_parcel_until_it_has_left() -> None:
    """All parcels obey the event rule."""
    stream = densest_stream(1.5, ("S", "B"))
    env = SlotVecEnv(training_env_config(0.04), 2, 14, lambda _: stream)
    env.seed(0)
    rule = StreamEventRule(EnvConfig("flow", exits="sides", actions="parcels"))
    seen, ended = np.asarray(env.reset()), []
    for _ in range(150):
        sat = seen[:, PRESENT] > 0.5
        choices = np.ones((env.num_envs, 3), dtype=np.int64)
        there = sat & (seen[:, WAITS] < 0.5)
        if there.any():
            choices[there, :2] = rule.halves(seen[there])
        next_seen, rewards, ends, infos = env.step(choices)
        after = np.asarray(next_seen)
        sits = after[:, PRESENT] > 0.5
        # No parcel changes slots: one that stays has moved by no more than a period's way.
        stays = sat & sits & ~ends
        assert np.abs(after[stays, 13] - seen[stays, 13]).max(initial=0.0) < 0.25
        assert not (sat & ~sits & ~ends).any()
        # A free slot observes and earns nothing; the observed side is mirrored.
        assert not seen[~sat].any()
        assert not rewards[~sat].any()
        assert (seen[:, SIDE] >= 0.0).all()
        ended += [info for info in infos if info]
        seen = after
    assert len(ended) > 20
    assert all(info["is_success"] for info in ended if not info["TimeLimit.truncated"])


def test_the_actor_waits_for_the_critic(tmp_path) -> None:
    waiting = replace(RUNS["parcels"][0], steps=4_000, critic_first=1_000_000)
    weights = []
    for name, config in (
        ("waiting", waiting), ("untaught", replace(waiting, steps=1, learning_rate=1e-30)),
    ):  # fmt: skip
        (tmp_path / name).mkdir()
        train(config, tmp_path / name)
        weights.append(torch.load(tmp_path / name / WEIGHTS, weights_only=True))
    found, before = weights
    actor = [name for name in found if name.startswith(("action_net", "mlp_extractor.policy_net"))]
    assert actor
    assert all(torch.equal(found[name], before[name]) for name in actor)
    assert not torch.equal(found["value_net.weight"], before["value_net.weight"])
