"""PPO on a device: rollouts and gradient steps are those of Stable-Baselines3's PPO."""

from collections import Counter
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from safetensors.torch import load_file
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import configure

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents.base import ActionMirror
from surface_gym.agents.learning import cuda
from surface_gym.agents.learning.algorithms import PPOConfig
from surface_gym.agents.learning.config import defaults
from surface_gym.agents.learning.runs import Curve, read_curve, train
from surface_gym.agents.learning.sb3 import make_mirrored_envs, make_model
from surface_gym.agents.library import WEIGHTS
from surface_gym.agents.vec_env import SurfaceVecEnv
from surface_gym.config import EnvConfig
from surface_gym.tasks import TASKS

from .envs_on_cpu import EnvsOnCpu, envs_on_cpu

NUM_ENVS, PERIODS, LONGEST = 16, 60, 20


def config(actions: str) -> PPOConfig:
    return PPOConfig(
        num_envs=NUM_ENVS, n_steps=PERIODS, batch_size=NUM_ENVS * PERIODS, n_epochs=1, hidden=(16,),
        camera_share=0.0, actions=actions, gamma=0.97, ent_coef=0.01, seed=5,
    )  # fmt: skip


def env(
    actions: str, task: str = "sort", num_envs: int = NUM_ENVS, longest: int = LONGEST
) -> SmartSurfaceVectorEnv:
    return SmartSurfaceVectorEnv(
        num_envs, task, actions=actions, max_episode_steps=longest, autoreset_mode="SameStep"
    )


def learner(actions: str) -> cuda.DeviceLearner:
    return cuda.DeviceLearner(config(actions), cuda.DeviceTrainingEnvs(EnvsOnCpu(env(actions))))


def assert_weights(policy: Any, other: Any, **most: float) -> None:
    for name, weight in other.state_dict().items():
        torch.testing.assert_close(policy.state_dict()[name], weight, **most)


@pytest.mark.parametrize("actions", ["halves", "quadrants"])
def test_a_gradient_step_is_that_of_stable_baselines3(actions) -> None:
    run = config(actions)
    model = make_model(run, make_mirrored_envs(run))
    assert isinstance(model, PPO)
    model.set_logger(configure(None, []))
    _, callback = model._setup_learn(run.batch_size)
    assert model.env is not None
    model.collect_rollouts(model.env, callback, model.rollout_buffer, PERIODS)
    with torch.no_grad():  # so that likelihoods have changed, some of them beyond the clip
        for weight in model.policy.parameters():
            weight += 0.2 * torch.randn_like(weight)
    policy = cuda.DevicePolicy(
        model.observation_space, model.action_space, lambda _: run.learning_rate, net_arch=[16]
    )
    policy.load_state_dict(model.policy.state_dict())
    found = next(model.rollout_buffer.get())
    samples = cuda.Samples(
        found.observations, found.actions.long(), found.old_log_prob, found.advantages,
        found.returns,
    )  # fmt: skip
    loss = cuda.policy_loss(policy, samples, run.ent_coef).item()
    cuda.gradient_step(policy, samples, run.ent_coef)
    model.train()
    assert model.logger.name_to_value["train/clip_fraction"] > 0.05
    assert loss == pytest.approx(model.logger.name_to_value["train/loss"], rel=1e-5)
    assert_weights(policy, model.policy, rtol=1e-4, atol=1e-6)


@torch.no_grad()
@pytest.mark.parametrize("actions", ["halves", "quadrants"])
def test_a_rollout_has_the_returns_of_stable_baselines3(actions) -> None:
    """Its buffer computes them from the same actions in other environments."""
    learning = learner(actions)
    learning.begin(7)
    samples = learning.roll_out()
    policy = learning.network
    vector_env = env(actions)
    others = SurfaceVecEnv(vector_env, mirror=ActionMirror(vector_env.config))
    others.seed(7)
    seen = np.asarray(others.reset())
    buffer = RolloutBuffer(
        PERIODS, others.observation_space, others.action_space, "cpu",
        config(actions).gae_lambda, config(actions).gamma, NUM_ENVS,
    )  # fmt: skip
    begins, kinds = np.ones(NUM_ENVS, dtype=np.bool_), set()
    for some in samples.actions.reshape(PERIODS, NUM_ENVS, -1):
        chosen = some.numpy().reshape(NUM_ENVS, *others.action_space.shape)
        before = torch.from_numpy(seen)
        values, likelihood, _ = policy.evaluate_actions(before, torch.from_numpy(chosen))
        next_seen, rewards, ended, infos = others.step(chosen)
        for i in np.nonzero(ended)[0]:
            kinds.add(infos[i]["TimeLimit.truncated"])
            if infos[i]["TimeLimit.truncated"]:
                last = torch.from_numpy(infos[i]["terminal_observation"])
                rewards[i] += config(actions).gamma * float(policy.predict_values(last[None]))
        buffer.add(seen, chosen, rewards, begins, values, likelihood)
        seen, begins = np.asarray(next_seen), ended
    assert kinds == {True, False}
    buffer.compute_returns_and_advantage(policy.predict_values(torch.from_numpy(seen)), begins)
    for ours, theirs in (
        (samples.advantage, buffer.advantages),
        (samples.returns, buffer.returns),
        (samples.log_prob, buffer.log_probs),
    ):
        np.testing.assert_allclose(ours.reshape(PERIODS, NUM_ENVS), theirs, rtol=1e-4, atol=2e-5)
    observations = samples.observations.reshape(PERIODS, NUM_ENVS, -1)
    np.testing.assert_array_equal(observations, buffer.observations)


def test_a_seed_gives_the_first_weights_of_stable_baselines3() -> None:
    model = make_model(config("halves"), make_mirrored_envs(config("halves")))
    assert_weights(learner("halves").network, model.policy, rtol=0.0, atol=0.0)


def test_a_single_choice_is_drawn_as_often_as_it_is_likely() -> None:
    torch.manual_seed(0)
    seen, wanted = spaces.Box(-1.0, 1.0, (2,)), torch.tensor([0.2, 0.5, 0.3])
    policy = cuda.DevicePolicy(seen, spaces.Discrete(3), lambda _: 0.0, net_arch=[4])
    with torch.no_grad():
        policy.action_net.weight.zero_()
        policy.action_net.bias[:] = wanted.log()
        actions, _, likelihood = policy(torch.zeros(20_000, 2))
    assert actions.shape == likelihood.shape == (20_000,)
    shares = torch.bincount(actions) / len(actions)
    torch.testing.assert_close(shares, wanted, rtol=0.0, atol=0.02)
    torch.testing.assert_close(likelihood.exp(), wanted[actions])


@pytest.mark.parametrize("actions", ["halves", "quadrants", "window", "modules"])
def test_actions_are_mirrored_as_on_the_cpu(actions) -> None:
    env_config = EnvConfig(actions=actions)
    rng = np.random.default_rng(0)
    shape = (300, *env_config.action_space().shape)
    given = rng.integers(len(env_config.chosen_orientations), size=shape)
    side = rng.integers(-1, 2, size=300).astype(np.float32)
    expected = ActionMirror(env_config)(given, side)
    mirror = cuda.TensorMirror(env_config, torch.device("cpu"))
    found = mirror(torch.from_numpy(given), torch.from_numpy(side))
    np.testing.assert_array_equal(found.numpy(), expected)
    assert (expected != given).any()


def test_episode_totals_are_the_sums_of_single_episodes() -> None:
    made = [env("halves", "stop", 12, 40) for _ in range(2)]
    envs, others = cuda.DeviceTrainingEnvs(EnvsOnCpu(made[0])), SurfaceVecEnv(made[1])
    envs.reset(3)
    others.seed(3)
    others.reset()
    rng = np.random.default_rng(0)
    expected: Counter[str] = Counter()
    for period in range(150):
        actions = rng.integers(others.action_space.n, size=12)
        moved = envs.step(torch.from_numpy(actions))
        observations, rewards, ended, infos = others.step(actions)
        last = np.asarray(observations).copy()
        for i in np.nonzero(ended)[0]:
            info = infos[i]
            last[i] = info["terminal_observation"]
            assert moved.terminated[i] == (not info["TimeLimit.truncated"])
            expected["episodes"] += 1
            expected["success"] += info["is_success"]
            expected["return"] += info["episode"]["r"]
            expected["length"] += info["episode"]["l"]
            expected.update({f"reward_{k}": value for k, value in info["reward_terms"].items()})
        np.testing.assert_array_equal(moved.observations, observations)
        np.testing.assert_array_equal(moved.last, last)
        np.testing.assert_array_equal(moved.ended, ended)
        np.testing.assert_allclose(moved.rewards, rewards, rtol=1e-6)
        if period == 100:  # fetched between, nothing is lost
            first = envs.totals.fetch()
    second = envs.totals.fetch()
    assert expected["episodes"] > 36
    for name, total in expected.items():
        assert first[name] + second[name] == pytest.approx(total, rel=1e-9), name
    assert not any(envs.totals.fetch().values())


def test_a_row_holds_means_over_the_fewest_latest_rollouts_with_enough_episodes(tmp_path) -> None:
    each = {"return": 2.0, "length": 10.0, "reward_reach": 3.0}

    def add(episodes: int, successes: int, least: int = 1000) -> None:
        sums = {name: value * episodes for name, value in each.items()}
        curve.add_totals({"episodes": episodes, "success": successes, **sums}, least)

    curve = Curve(tmp_path, ("reach",), 0, [])
    add(0, 0)  # a rollout in which none ended
    assert np.isnan(curve.success)
    add(300, 0)
    add(600, 300)
    curve.write(100)
    add(500, 500)  # 600 and 500 are enough
    curve.write(200)
    curve.close()
    first, second = read_curve(tmp_path)
    assert first == {"steps": 100, "success": pytest.approx(1 / 3), **each}
    assert second["success"] == pytest.approx(800 / 1100)
    again = Curve(tmp_path, ("reach",), 200, list(curve.recent))
    assert again.success == curve.success
    again.close()
    for successes in (0, 0, 0, 1500):
        add(1500, successes, least=3000)
    assert curve.success == 0.5


def test_it_learns_to_sort(tmp_path) -> None:
    run = PPOConfig(
        device="cuda", camera_share=0.0, seed=3, steps=65_536, checkpoint_every=10**6,
        num_envs=128, n_steps=32, batch_size=1024, n_epochs=8, learning_rate=5e-3, hidden=(32, 32),
    )  # fmt: skip
    cuda.train_on_device(run, tmp_path, make_envs=envs_on_cpu)
    _, _, _, early, *_, late = read_curve(tmp_path)
    assert late["success"] > max(0.2, 5.0 * early["success"])
    assert late["return"] > early["return"]


@pytest.mark.parametrize("observe", [(), ("load",)], ids=["alone", "load"])
def test_environments_are_made_as_the_run_says(observe, tmp_path, monkeypatch) -> None:
    given = {"control_period": 0.02, "observe": observe}
    run = defaults("slow", "ppo", device="cuda")
    small = replace(run, **given, num_envs=7, n_steps=2, batch_size=14, steps=14)
    assert isinstance(small, PPOConfig)
    asked: dict[str, object] = {}

    def make_vec(name: str, **arguments: object) -> EnvsOnCpu:
        asked.update(arguments, name=name)
        return envs_on_cpu(small, small.num_envs)

    monkeypatch.setattr(gym, "make_vec", make_vec)
    assert train(small, tmp_path).steps == 14
    task = TASKS["slow"]()
    assert asked == {
        "name": "SmartSurface/Slow-v0", "num_envs": 7, "device": "cuda", "task": task,
        "max_episode_steps": task.periods, "actions": "halves", "autoreset_mode": "SameStep",
        **given,
    }  # fmt: skip


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu_a_rollout_never_waits_and_a_seed_fixes_the_weights(tmp_path) -> None:
    run = replace(config("halves"), device="cuda", steps=2 * NUM_ENVS * PERIODS)
    on_gpu = cuda.DeviceLearner(run, cuda.DeviceTrainingEnvs(cuda.make_device_envs(run, NUM_ENVS)))
    on_gpu.begin(0)
    on_gpu.roll_out()  # the first may compile
    torch.cuda.set_sync_debug_mode("error")
    try:
        on_gpu.roll_out()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    for name in ("one", "again"):
        (tmp_path / name).mkdir()
        cuda.train_on_device(run, tmp_path / name)
    first, second = (load_file(tmp_path / name / WEIGHTS) for name in ("one", "again"))
    assert all(torch.equal(values, second[name]) for name, values in first.items())
