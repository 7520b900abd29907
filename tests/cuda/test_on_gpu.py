"""What takes a GPU to see. Where there is none, these are skipped; nothing else stands for them."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from surface_gym.registration import FLOW
from tests.cuda.cases import CASES, FLOWS, actions_of, every_case, id_of

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")

LANES = 2048


def pair(name, lanes=LANES, **given):
    _, settings = CASES[name]
    return [
        gym.make_vec(id_of(name), num_envs=lanes, device=device, **settings, **given)
        for device in ("cpu", "cuda")
    ]


@every_case
def test_an_episode_is_that_of_the_cpu_but_for_the_last_digits(name):
    cpu, gpu = pair(name, autoreset_mode="NextStep")
    first, _ = cpu.reset(seed=0)
    np.testing.assert_allclose(gpu.reset(seed=0)[0].cpu(), first, atol=1e-6)
    running = np.ones(LANES, dtype=np.bool_)
    near, same = running.copy(), running.copy()
    for action in actions_of(cpu, 40):
        *_, ended, late, infos = cpu.step(action)
        *_, over, cut, found = gpu.step(torch.from_numpy(action).cuda())
        apart = np.abs(infos["pose"] - found["pose"].cpu().numpy()).max(axis=1)
        near &= ~running | (apart < 1e-8)
        same &= ~running | ((ended == over.cpu().numpy()) & (late == cut.cpu().numpy()))
        running &= ~(ended | late)
    assert near.mean() >= 0.999
    assert same.mean() >= 0.999
    gpu.close()


@pytest.mark.parametrize("name", FLOWS)
def test_a_flow_is_that_of_the_cpu_but_for_the_last_digits(name):
    given = {"num_envs": 64, **FLOWS[name]}
    cpu, gpu = (gym.make_vec(FLOW, device=device, **given) for device in ("cpu", "cuda"))
    first, _ = cpu.reset(seed=0)
    np.testing.assert_allclose(gpu.reset(seed=0)[0].cpu(), first, atol=1e-6)
    for action in actions_of(cpu, 28):
        seen, *_, infos = cpu.step(action)
        felt, *_, found = gpu.step(torch.from_numpy(action).cuda())
    near = np.isclose(felt.cpu(), seen, atol=1e-5).all(axis=(1, 2))
    assert near.mean() >= 0.95  # a touch that comes a step sooner or later moves what follows
    assert (infos["entered"] == found["entered"].cpu().numpy()).mean() >= 0.95
    gpu.close()


def test_the_same_seed_gives_the_same_on_the_same_device():
    found = []
    for _ in range(2):
        env = gym.make_vec(id_of("sort"), num_envs=LANES, actions="halves", device="cuda")
        env.reset(seed=1)
        generator = torch.Generator("cuda").manual_seed(2)
        for _ in range(60):
            actions = torch.randint(0, 16, (LANES,), device="cuda", generator=generator)
            observation, rewards, *_ = env.step(actions)
        found.append((observation, rewards))
        env.close()
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])


def test_a_lane_does_not_depend_on_how_many_there_are():
    found = []
    for lanes in (64, LANES):
        env = gym.make_vec(id_of("slow"), num_envs=lanes, actions="halves", device="cuda")
        env.reset(seed=1)
        for choice in range(60):
            observation, *_ = env.step(torch.full((lanes,), choice % 16, device="cuda"))
        found.append(observation[:64])
        env.close()
    assert torch.equal(*found)


def test_nothing_goes_through_the_host():
    env = gym.make_vec(id_of("sort"), num_envs=64, device="cuda", autoreset_mode="SameStep")
    observation, _ = env.reset(seed=0)
    step = env.step(torch.zeros((64, *env.single_action_space.shape), dtype=int, device="cuda"))
    assert observation.is_cuda
    assert all(each.is_cuda for each in step[:4])
    assert torch.from_dlpack(observation).data_ptr() == observation.data_ptr()
    env.close()


def test_an_action_out_of_range_is_told_in_time():
    env = gym.make_vec(id_of("sort"), num_envs=64, actions="halves", device="cuda")
    env.reset(seed=0)
    bad = torch.full((64,), 16, device="cuda")
    with pytest.raises(ValueError, match="action must be between 0 and 15"):
        list(map(env.step, [bad] * 65))
    env.close()
