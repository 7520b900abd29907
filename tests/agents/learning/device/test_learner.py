"""Rollouts and gradient steps are those of Stable-Baselines3's PPO."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import configure

from agents.learning.config import PPOConfig
from agents.learning.device.lanes import Practice
from agents.learning.device.learner import Learner, Samples, gradient_step, ppo_loss
from agents.learning.device.policy import DevicePolicy
from agents.learning.model import make_model
from agents.learning.practice import make_practice
from agents.mirror import ActionMirror, MirrorVecEnv
from agents.vec_env import SurfaceVecEnv
from surface_gym import SmartSurfaceVectorEnv

from .lanes_on_cpu import LanesOnCpu

LANES, PERIODS, LONGEST = 16, 60, 20


def config(actions: str) -> PPOConfig:
    return PPOConfig(
        lanes=LANES, n_steps=PERIODS, batch_size=LANES * PERIODS, n_epochs=1, hidden=(16,),
        camera_share=0.0, actions=actions, gamma=0.97, ent_coef=0.01, seed=5,
    )  # fmt: skip


def env(actions: str) -> SmartSurfaceVectorEnv:
    mode = gym.vector.AutoresetMode.SAME_STEP
    return SmartSurfaceVectorEnv(
        LANES, actions=actions, max_episode_steps=LONGEST, autoreset_mode=mode
    )


def learner(actions: str) -> Learner:
    return Learner(config(actions), Practice(LanesOnCpu(env(actions))))


@pytest.mark.parametrize("actions", ["halves", "quadrants"])
def test_a_gradient_step(actions: str) -> None:
    of_run = config(actions)
    model = make_model(of_run, make_practice(of_run))
    assert isinstance(model, PPO)
    model.set_logger(configure(None, []))
    _, callback = model._setup_learn(of_run.batch_size)
    assert model.env is not None
    model.collect_rollouts(model.env, callback, model.rollout_buffer, PERIODS)
    with torch.no_grad():  # so that likelihoods have changed, some of them beyond the clip
        for weight in model.policy.parameters():
            weight += 0.2 * torch.randn_like(weight)
    policy = DevicePolicy(
        model.observation_space, model.action_space, lambda _: of_run.learning_rate, net_arch=[16]
    )
    policy.load_state_dict(model.policy.state_dict())
    found = next(model.rollout_buffer.get())
    samples = Samples(
        found.observations, found.actions.long(), found.old_log_prob, found.advantages,
        found.returns,
    )  # fmt: skip
    loss = ppo_loss(policy, samples, of_run.ent_coef).item()
    gradient_step(policy, samples, of_run.ent_coef)
    model.train()
    assert model.logger.name_to_value["train/clip_fraction"] > 0.05
    assert loss == pytest.approx(model.logger.name_to_value["train/loss"], rel=1e-5)
    for name, weight in model.policy.state_dict().items():
        torch.testing.assert_close(policy.state_dict()[name], weight, rtol=1e-4, atol=1e-6)


@torch.no_grad()
@pytest.mark.parametrize("actions", ["halves", "quadrants"])
def test_a_rollout_is_worth_what_stable_baselines3_makes_of_it(actions: str) -> None:
    """Its actions, taken in its own lanes; its buffer sums the rewards up."""
    learning = learner(actions)
    learning.begin(7)
    samples = learning.roll_out()
    policy = learning.network
    lanes = env(actions)
    settings = lanes.settings
    others = MirrorVecEnv(
        SurfaceVecEnv(lanes), ActionMirror(settings.action_kind, settings.chosen_orientations)
    )
    others.seed(7)
    seen = np.asarray(others.reset())
    buffer = RolloutBuffer(
        PERIODS, others.observation_space, others.action_space, "cpu",
        config(actions).gae_lambda, config(actions).gamma, LANES,
    )  # fmt: skip
    begins, kinds = np.ones(LANES, dtype=np.bool_), set()
    for some in samples.actions.reshape(PERIODS, LANES, -1):
        chosen = some.numpy().reshape(LANES, *others.action_space.shape)
        before = torch.from_numpy(seen)
        values, likelihood, _ = policy.evaluate_actions(before, torch.from_numpy(chosen))
        next_seen, rewards, ended, infos = others.step(chosen)
        for lane in np.nonzero(ended)[0]:
            kinds.add(infos[lane]["TimeLimit.truncated"])
            if infos[lane]["TimeLimit.truncated"]:
                last = torch.from_numpy(infos[lane]["terminal_observation"])
                rewards[lane] += config(actions).gamma * float(policy.predict_values(last[None]))
        buffer.add(seen, chosen, rewards, begins, values, likelihood)
        seen, begins = np.asarray(next_seen), ended
    assert kinds == {True, False}
    buffer.compute_returns_and_advantage(policy.predict_values(torch.from_numpy(seen)), begins)
    for ours, theirs in (
        (samples.advantage, buffer.advantages),
        (samples.worth, buffer.returns),
        (samples.likelihood, buffer.log_probs),
    ):
        np.testing.assert_allclose(ours.reshape(PERIODS, LANES), theirs, rtol=1e-4, atol=2e-5)
    seen_by_all = samples.observations.reshape(PERIODS, LANES, -1)
    np.testing.assert_array_equal(seen_by_all, buffer.observations)


@pytest.mark.parametrize("actions", ["halves", "quadrants"])
def test_a_seed_gives_the_first_weights_of_stable_baselines3(actions: str) -> None:
    model = make_model(config(actions), make_practice(config(actions)))
    first = learner(actions).network.state_dict()
    for name, weight in model.policy.state_dict().items():
        assert torch.equal(first[name], weight), name


def test_a_single_choice_is_drawn_as_often_as_it_is_likely() -> None:
    torch.manual_seed(0)
    seen = spaces.Box(-1.0, 1.0, (2,))
    policy = DevicePolicy(seen, spaces.Discrete(3), lambda _: 0.0, net_arch=[4])
    with torch.no_grad():
        policy.action_net.weight.zero_()
        policy.action_net.bias[:] = torch.tensor([0.2, 0.5, 0.3]).log()
        actions, _, likelihood = policy(torch.zeros(20_000, 2))
    assert actions.shape == likelihood.shape == (20_000,)
    shares = torch.bincount(actions) / len(actions)
    torch.testing.assert_close(shares, torch.tensor([0.2, 0.5, 0.3]), rtol=0.0, atol=0.02)
    torch.testing.assert_close(likelihood.exp(), torch.tensor([0.2, 0.5, 0.3])[actions])
