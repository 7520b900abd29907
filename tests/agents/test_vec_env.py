"""The adapter for Stable-Baselines3: a test for every trap of its contract."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

import surface_gym as sg
from surface_gym.agents.vec_env import SurfaceVecEnv
from surface_gym.sensors import Camera

NUM_ENVS = 4
ROLL = 15  # halves, all axes at 90 deg


def make(limit: int | None = 12, **config: object) -> SurfaceVecEnv:
    return SurfaceVecEnv(
        sg.SmartSurfaceVectorEnv(
            NUM_ENVS, actions="halves", max_episode_steps=limit, autoreset_mode="SameStep", **config
        )
    )


def test_only_same_step_is_taken_and_pictures_come() -> None:
    with pytest.raises(ValueError, match="SAME_STEP"):
        SurfaceVecEnv(sg.SmartSurfaceVectorEnv(NUM_ENVS))
    assert make().render_mode is None
    env = make(render_mode="rgb_array")
    assert env.render_mode == "rgb_array"
    env.reset()
    pictures = env.get_images()
    assert len(pictures) == NUM_ENVS
    assert all(picture.dtype == np.uint8 for picture in pictures)


def test_attributes_and_methods_are_the_vector_envs() -> None:
    env = make()
    assert env.get_attr("num_envs") == [NUM_ENVS] * NUM_ENVS
    assert env.get_attr("num_envs", indices=[0, 2]) == [NUM_ENVS] * 2
    assert env.get_attr("num_envs", indices=1) == [NUM_ENVS]
    assert env.env_is_wrapped(gym.Wrapper, indices=[1, 2]) == [False, False]
    with pytest.raises(ValueError, match="indices"):
        env.set_attr("render_mode", None, indices=[0])
    with pytest.raises(AttributeError):
        env.get_attr("no_such_thing")
    env.set_attr("note", "shared")
    assert env.get_attr("note") == ["shared"] * NUM_ENVS
    assert env.has_attr("config")
    assert not env.has_attr("no_such_thing")
    assert env.env_method("__str__", indices=[0, 1]) == [str(env.envs[0])] * 2


def test_environments_are_single_ones_and_their_ends_are_reported() -> None:
    env = make()
    env.seed(3)
    observations = env.reset()
    given = {"actions": "halves", "max_episode_steps": 12}
    singles = [gym.make("SmartSurface/Sort-v0", **given) for _ in range(NUM_ENVS)]
    for i, single in enumerate(singles):
        np.testing.assert_array_equal(single.reset(seed=3 + i)[0], observations[i])
    rng = np.random.default_rng(0)
    ends, lasted = [], np.zeros(NUM_ENVS, dtype=np.int64)
    for _ in range(60):
        actions = rng.integers(0, 16, NUM_ENVS)
        observations, rewards, dones, infos = env.step(actions)
        lasted += 1
        for i, single in enumerate(singles):
            seen, reward, terminated, truncated, info = single.step(actions[i])
            assert (rewards[i], dones[i]) == (np.float32(reward), terminated or truncated)
            if dones[i]:
                assert infos[i]["episode"]["l"] == lasted[i]
                lasted[i] = 0
                ends.append((infos[i], seen.copy(), terminated, truncated, info))
                seen, _ = single.reset()
            else:
                assert infos[i] == {}
            np.testing.assert_array_equal(observations[i], seen)
    assert {end[3] and not end[2] for end in ends} == {True, False}
    for reported, seen, terminated, truncated, info in ends:
        np.testing.assert_array_equal(reported["terminal_observation"], seen)
        assert reported["TimeLimit.truncated"] == (truncated and not terminated)
        assert reported["is_success"] == info["is_success"]
        assert reported["outcome"] == info["outcome"] or reported["TimeLimit.truncated"]


def test_what_comes_back_is_fresh_and_writable() -> None:
    env = make()
    first = env.reset()
    kept = first.copy()
    first[:] = 7.0
    observations, rewards, dones, _ = env.step(np.full(NUM_ENVS, ROLL))
    assert not (observations == 7.0).any()
    for array in (observations, rewards, dones):
        assert array.flags.writeable
        array[:] = 1
    again, *_ = env.step(np.full(NUM_ENVS, ROLL))
    assert again is not observations
    assert not (again == 1.0).all()
    assert not (again == kept).all()


def test_seed_and_options_act_at_the_next_reset_alone() -> None:
    env = make()
    env.reset()
    env.seed(5)
    env.set_options([{"speed": 0.5 + i} for i in range(NUM_ENVS)])
    before = env.envs[0].batch.parcels.truth.copy()
    env.step(np.full(NUM_ENVS, ROLL))
    assert (np.abs(env.envs[0].batch.parcels.truth[:, 3] - before[:, 3]) < 0.1).all()
    env.reset()
    np.testing.assert_array_equal(env.envs[0].batch.parcels.truth[:, 3], [0.5, 1.5, 2.5, 3.5])
    env.reset()
    assert (env.envs[0].batch.parcels.truth[:, 3] != [0.5, 1.5, 2.5, 3.5]).any()


def test_episode_returns_are_the_monitors() -> None:
    env = VecMonitor(make())
    env.seed(0)
    env.reset()
    returns, lengths = np.zeros(NUM_ENVS), np.zeros(NUM_ENVS, dtype=int)
    found = 0
    for _ in range(40):
        _, rewards, dones, infos = env.step(np.full(NUM_ENVS, 10))
        returns += rewards
        lengths += 1
        for i in np.nonzero(dones)[0]:
            found += 1
            assert infos[i]["episode"]["r"] == pytest.approx(returns[i], abs=1e-5)
            assert infos[i]["episode"]["l"] == lengths[i]
            terms = infos[i]["reward_terms"]
            assert set(terms) == {"reach", "time", "success", "haste", "failure"}
            assert sum(terms.values()) == pytest.approx(returns[i], abs=1e-5)
            returns[i] = lengths[i] = 0
    assert found > NUM_ENVS


def test_stable_baselines3_learns_on_it_and_evaluates_on_it() -> None:
    model = PPO("MlpPolicy", make(), n_steps=8, batch_size=16, n_epochs=1, seed=0, device="cpu")
    model.learn(64)
    env, found = VecMonitor(make()), []
    for _ in range(2):
        env.seed(0)
        found.append(evaluate_policy(model, env, 6, return_episode_rewards=True))
    assert found[0] == found[1]
    returns, lengths = found[0]
    assert len(returns) == 6
    assert max(lengths) <= 12


def test_a_reset_starts_returns_anew() -> None:
    env = make(limit=3)
    for periods in (1, 3):
        env.reset()
        for _ in range(periods):
            _, _, dones, infos = env.step(np.full(NUM_ENVS, ROLL))
    assert dones.all()
    assert [info["episode"]["l"] for info in infos] == [3] * NUM_ENVS


def test_concatenated_environments_are_those_apart() -> None:
    def halves() -> list[SurfaceVecEnv]:
        return [make(), make(sensors=Camera())]

    together, apart = SurfaceVecEnv(*(each.envs[0] for each in halves())), halves()
    for env, seed in ((together, 10), (apart[0], 10), (apart[1], 10 + NUM_ENVS)):
        env.seed(seed)
    first = together.reset()
    np.testing.assert_array_equal(first, np.concatenate([each.reset() for each in apart]))
    rng = np.random.default_rng(0)
    for _ in range(60):
        actions = rng.integers(0, 16, (2, NUM_ENVS))
        *found, infos = together.step(actions.ravel())
        parts = [each.step(some) for each, some in zip(apart, actions, strict=True)]
        for k, whole in enumerate(found):  # observations, rewards and ends
            np.testing.assert_array_equal(whole, np.concatenate([part[k] for part in parts]))
        assert [bool(info) for info in infos] == found[2].tolist()
    assert together.get_attr("num_envs", [0, NUM_ENVS]) == [NUM_ENVS] * 2
    assert together.env_is_wrapped(gym.Wrapper, [1]) == [False]
    together.close()
    assert together.get_attr("closed") == [True] * 2 * NUM_ENVS
