"""Where a vector env runs: what is missing, and what is not there on a GPU, is told by name."""

from importlib.util import find_spec

import gymnasium as gym
import pytest
import torch

import surface_gym as sg
from surface_gym.cuda import env
from surface_gym.cuda.env import DeviceMissing, check_device
from surface_gym.sensors import Camera
from surface_gym.vector_env import DEVICES, make_device_env, make_vector_env
from tests.cuda.cases import needs_numba_cuda

SORT = "SmartSurface/Sort-v0"


def test_the_cpu_is_where_it_runs_by_default():
    assert isinstance(gym.make_vec(SORT, num_envs=2), sg.SmartSurfaceVectorEnv)
    assert isinstance(gym.make_vec(SORT, num_envs=2, device="cpu"), sg.SmartSurfaceVectorEnv)
    assert DEVICES == ("cpu", "cuda")


def test_a_device_that_there_is_not_is_an_error():
    with pytest.raises(ValueError, match="device must be one of 'cpu', 'cuda', got 'tpu'"):
        make_vector_env(2, "tpu")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
@needs_numba_cuda
def test_without_a_gpu_an_error_says_so():
    with pytest.raises(DeviceMissing, match="needs an NVIDIA GPU; torch"):
        gym.make_vec(SORT, num_envs=2, device="cuda")


@pytest.mark.parametrize("module", ["torch", "numba_cuda"])
def test_without_the_extra_an_error_names_it(monkeypatch, module):
    def found(name):
        return None if name == module else find_spec(name)

    monkeypatch.setattr(env, "find_spec", found)
    with pytest.raises(DeviceMissing, match=rf"{module}, which is not installed: .*\[gpu\]"):
        check_device()


@needs_numba_cuda
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sensors": Camera()}, "sensors must be one without noise.* got Camera"),
        ({"condition": "lab"}, "sensors must be one without noise"),
        ({"randomisation": sg.Randomisation(mass=0.1)}, "randomisation must be .* mass=0.1"),
        ({"actuators": sg.Actuators(stuck_share=0.1)}, "stuck_share must be 0.*, got 0.1"),
        ({"info": ("axes",)}, r"info must be \(\), where device is 'cuda', got \('axes',\)"),
        ({"render_mode": "rgb_array"}, "render_mode must be None"),
        ({"threads": 2}, "threads must be 1"),
        ({"num_envs": 0}, "num_envs must be"),
        ({"autoreset_mode": "Never"}, "autoreset_mode must be one of"),
        ({"max_episode_steps": 0}, "max_episode_steps must be"),
        ({"actions": "thirds"}, "actions must be one of"),
    ],
)
def test_what_a_gpu_does_not_have_is_named(arguments, message):
    given = {"num_envs": 2, "device": "cpu", "task": "sort", **arguments}
    with pytest.raises(ValueError, match=message):
        make_device_env(**given)


@needs_numba_cuda
def test_a_parcel_that_the_task_does_not_draw_is_refused_and_nothing_has_moved():
    env = make_device_env(2, "cpu", task="sort")
    own = sg.Parcel(sg.Disc(0.1))
    with pytest.raises(ValueError, match="parcel must be one that the task draws"):
        env.reset(seed=0, options={"parcel": own})
    with pytest.raises(gym.error.ResetNeeded):
        env.step(torch.zeros(2, dtype=torch.int64))
    env.close()
