"""Tests that need a GPU, skipped where there is none; nothing else stands for them."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from surface_gym.vector_env import make_vector_env
from tests.cuda.cases import CASES, STREAMS, every_case, sample_actions

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")

NUM_ENVS = 2048


def make_pair(num_envs, **arguments):
    return [make_vector_env(num_envs, device, **arguments) for device in ("cpu", "cuda")]


def make_gpu(task="sort", num_envs=64, **arguments):
    env_id = f"SmartSurface/{task.title()}-v0"
    return gym.make_vec(env_id, num_envs=num_envs, actions="halves", device="cuda", **arguments)


@every_case
def test_an_episode_equals_the_cpus_but_for_the_last_digits(name):
    cpu, gpu = make_pair(NUM_ENVS, autoreset_mode="NextStep", **CASES[name])
    first, _ = cpu.reset(seed=0)
    np.testing.assert_allclose(gpu.reset(seed=0)[0].cpu(), first, atol=1e-6)
    running = np.ones(NUM_ENVS, dtype=np.bool_)
    near, same = running.copy(), running.copy()
    for action in sample_actions(cpu, 40):
        *_, terminated, truncated, infos = cpu.step(action)
        *_, over, cut, found = gpu.step(torch.from_numpy(action).cuda())
        apart = np.abs(infos["pose"] - found["pose"].cpu().numpy()).max(axis=1)
        ends = (terminated == over.cpu().numpy()) & (truncated == cut.cpu().numpy())
        near &= ~running | (apart < 1e-8)
        same &= ~running | ends
        running &= ~(terminated | truncated)
    assert near.mean() >= 0.999
    assert same.mean() >= 0.999
    gpu.close()


@pytest.mark.parametrize("name", STREAMS)
def test_a_stream_equals_the_cpus_but_for_the_last_digits(name):
    cpu, gpu = make_pair(64, **STREAMS[name])
    first, _ = cpu.reset(seed=0)
    np.testing.assert_allclose(gpu.reset(seed=0)[0].cpu(), first, atol=1e-6)
    for action in sample_actions(cpu, 28):
        expected, *_, infos = cpu.step(action)
        given, *_, found = gpu.step(torch.from_numpy(action).cuda())
    near = np.isclose(given.cpu(), expected, atol=1e-5).all(axis=(1, 2))
    assert near.mean() >= 0.95  # a touch that comes a step sooner or later moves what follows
    assert (infos["entered"] == found["entered"].cpu().numpy()).mean() >= 0.95
    gpu.close()


def test_the_same_seed_gives_the_same_on_the_same_device():
    found = []
    for _ in range(2):
        env = make_gpu(num_envs=NUM_ENVS)
        env.reset(seed=1)
        generator = torch.Generator("cuda").manual_seed(2)
        for _ in range(60):
            actions = torch.randint(0, 16, (NUM_ENVS,), device="cuda", generator=generator)
            observation, rewards, *_ = env.step(actions)
        found.append((observation, rewards))
        env.close()
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])


def test_an_environment_does_not_depend_on_how_many_there_are():
    found = []
    for num_envs in (64, NUM_ENVS):
        env = make_gpu("slow", num_envs)
        env.reset(seed=1)
        for choice in range(60):
            observation, *_ = env.step(torch.full((num_envs,), choice % 16, device="cuda"))
        found.append(observation[:64])
        env.close()
    assert torch.equal(*found)


def test_nothing_passes_through_the_host():
    env = make_gpu(autoreset_mode="SameStep")
    observation, _ = env.reset(seed=0)
    step = env.step(torch.zeros((64, *env.single_action_space.shape), dtype=int, device="cuda"))
    assert observation.is_cuda
    assert all(each.is_cuda for each in step[:4])
    assert torch.from_dlpack(observation).data_ptr() == observation.data_ptr()
    env.close()


def test_an_action_out_of_range_is_reported_in_time():
    env = make_gpu()
    env.reset(seed=0)
    bad = torch.full((64,), 16, device="cuda")
    with pytest.raises(ValueError, match="action must be between 0 and 15"):
        list(map(env.step, [bad] * 65))
    env.close()
