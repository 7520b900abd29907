"""The vector environment of tensors: its arguments, its actions, and errors that name the cause."""

import math

import gymnasium as gym
import numpy as np
import pytest
import torch

import surface_gym as sg
from surface_gym import cuda
from surface_gym.config import EnvConfig
from surface_gym.cuda import DeviceMissing, check_device, has_numba_cuda
from surface_gym.cuda.env import TensorActions
from surface_gym.sensors import Camera
from surface_gym.vector_env import DEVICES, make_device_env, make_vector_env
from tests.cuda.cases import needs_numba_cuda

SORT = "SmartSurface/Sort-v0"
NUM_ENVS = 5
CPU = torch.device("cpu")


class TestDevice:
    def test_the_default_is_the_cpu_and_an_unknown_one_an_error(self):
        for device in ({}, {"device": "cpu"}):
            env = gym.make_vec(SORT, num_envs=2, **device)
            assert isinstance(env, sg.SmartSurfaceVectorEnv)
        assert DEVICES == ("cpu", "cuda")
        with pytest.raises(ValueError, match="device must be one of 'cpu', 'cuda', got 'tpu'"):
            make_vector_env(2, "tpu")

    @pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
    @pytest.mark.skipif(not has_numba_cuda(), reason="numba.cuda is not numba-cuda's")
    def test_a_missing_gpu_is_an_error(self):
        with pytest.raises(DeviceMissing, match="needs an NVIDIA GPU; torch"):
            gym.make_vec(SORT, num_envs=2, device="cuda")

    @pytest.mark.parametrize("module", ["torch", "numba_cuda"])
    def test_a_missing_library_is_named(self, monkeypatch, module):
        monkeypatch.setattr(cuda, "find_spec", lambda name: name != module or None)
        with pytest.raises(DeviceMissing, match=rf"{module}, which is not installed: .*\[gpu\]"):
            check_device()

    @needs_numba_cuda
    def test_numbas_own_copy_is_refused(self, monkeypatch):
        monkeypatch.setattr(cuda, "has_numba_cuda", lambda: False)
        with pytest.raises(DeviceMissing, match="needs numba-cuda beside the other packages"):
            check_device()


@needs_numba_cuda
class TestArguments:
    def test_an_argument_that_is_not_supported_is_named(self):
        for arguments, message in (
            ({"sensors": Camera()}, "sensors must be one without noise.* got Camera"),
            ({"task": "flow", "sensors": Camera()}, "sensors must be one without noise"),
            ({"preset": "lab"}, "sensors must be one without noise"),
            ({"randomisation": sg.Randomisation(mass=0.1)}, "randomisation must be .* mass=0.1"),
            ({"actuators": sg.Actuators(stuck_share=0.1)}, "stuck_share must be 0.*, got 0.1"),
            ({"info": ("axes",)}, r"info must be \(\), where device is 'cuda', got \('axes',\)"),
            ({"task": "flow", "info": ("axes",)}, r"info must be \(\)"),
            ({"render_mode": "rgb_array"}, "render_mode must be None"),
            ({"threads": 2}, "threads must be 1"),
            ({"num_envs": 0}, "num_envs must be"),
            ({"autoreset_mode": "Never"}, "autoreset_mode must be one of"),
            ({"max_episode_steps": 0}, "max_episode_steps must be"),
            ({"actions": "thirds"}, "actions must be one of"),
        ):
            given = {"num_envs": 2, "device": "cpu", "task": "sort", **arguments}
            with pytest.raises(ValueError, match=message):
                make_device_env(**given)

    def test_a_parcel_that_the_task_does_not_draw_is_refused_and_nothing_begins(self):
        env = make_device_env(2, "cpu", task="sort")
        with pytest.raises(ValueError, match="parcel must be one that the task draws"):
            env.reset(seed=0, options={"parcel": sg.Parcel(sg.Disc(0.1))})
        with pytest.raises(gym.error.ResetNeeded):
            env.step(torch.zeros(2, dtype=torch.int64))
        env.close()


def action_kind(actions, orientations=None):
    return EnvConfig(actions=actions, orientations=orientations).action_kind


class TestActions:
    @pytest.mark.parametrize("orientations", [None, "any"])
    @pytest.mark.parametrize("actions", ["modules", "halves", "quadrants", "window"])
    def test_commands_are_those_of_the_cpu(self, actions, orientations):
        kind = action_kind(actions, orientations)
        space = kind.space()
        space.seed(0)
        given = np.array([space.sample() for _ in range(NUM_ENVS)])
        converter = TensorActions(space, NUM_ENVS, CPU)
        commands = converter.commands(torch.from_numpy(given))
        np.testing.assert_array_equal(commands, kind.commands(given, NUM_ENVS))
        assert commands.dtype == (torch.float64 if orientations == "any" else torch.int64)
        assert not converter.wrong

    def test_an_action_out_of_range_is_recorded_and_replaced(self):
        for bad in (-1, 16, 2**40):
            converter = TensorActions(action_kind("halves").space(), NUM_ENVS, CPU)
            actions = torch.full((NUM_ENVS,), 5)
            actions[3] = bad
            assert converter.commands(actions).tolist() == [[1, 1]] * 3 + [[0, 0], [1, 1]]
            assert converter.wrong
            assert converter.allowed == "0 and 15"
        for bad in (math.nan, math.inf, 1.6, -1.6):
            converter = TensorActions(action_kind("halves", "any").space(), NUM_ENVS, CPU)
            assert (converter.commands(torch.full((NUM_ENVS, 2), bad)) == 0.0).all()
            assert converter.wrong

    def test_a_wrong_type_or_shape_is_an_error_at_once(self):
        for orientations, actions, message in (
            (None, np.zeros(NUM_ENVS, dtype=np.int64), "must be a torch tensor on cpu, got"),
            (None, torch.zeros(NUM_ENVS, device="meta"), "on cpu, got one on meta"),
            (None, torch.zeros(NUM_ENVS + 1), r"shape \(\) for each environment, got \(6,\)"),
            (None, torch.zeros(NUM_ENVS), "whole numbers, got torch.float32"),
            (None, torch.zeros(NUM_ENVS, dtype=torch.bool), "whole numbers, got torch.bool"),
            ("any", torch.zeros((NUM_ENVS, 2), dtype=torch.int64), "angles, got torch.int64"),
        ):
            converter = TensorActions(action_kind("halves", orientations).space(), NUM_ENVS, CPU)
            with pytest.raises(ValueError, match=message):
                converter.commands(actions)
