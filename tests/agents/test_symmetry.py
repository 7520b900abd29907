"""Mirror symmetry of Sort: a policy that sorts to y > 0 sorts, mirrored, to y < 0."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.actions import KINDS
from surface_gym.agents.base import SIDE, ActionMirror
from surface_gym.agents.learning.algorithms import DQNConfig
from surface_gym.agents.learning.sb3 import make_mirrored_envs
from surface_gym.config import EnvConfig
from surface_gym.layouts import LINE_Y


@pytest.mark.parametrize("actions", KINDS)
@pytest.mark.parametrize("parcel", ["S", "B"])
def test_trajectories_are_mirror_images(actions, parcel) -> None:
    config = EnvConfig(actions=actions)
    mirror = ActionMirror(config)
    env = sg.SmartSurfaceVectorEnv(2, actions=actions, autoreset_mode="Disabled")
    sides = np.array([1.0, -1.0], dtype=np.float32)
    starts = [{"speed": 1.6, "parcel": parcel, "side": side} for side in (1, -1)]
    env.reset(seed=0, options=starts)
    env.single_action_space.seed(0)
    for _ in range(100):
        one = env.single_action_space.sample()
        observations, rewards, terminated, _, info = env.step(mirror(np.array([one, one]), sides))
        seen = np.delete(observations, SIDE, axis=1)
        np.testing.assert_allclose(seen[0], seen[1], rtol=0, atol=2e-6)
        image = info["pose"][1] * [1.0, -1.0, -1.0] + [0.0, 2.0 * LINE_Y, 0.0]
        np.testing.assert_allclose(info["pose"][0], image, rtol=0, atol=1e-9)
        assert rewards[0] == pytest.approx(rewards[1], abs=1e-9)
        if terminated.any():
            break
    assert info["time"].min() > 0.4
    assert terminated.all()
    assert info["outcome"][0] == info["outcome"][1]


@pytest.mark.parametrize("actions", KINDS)
def test_a_mirror_image_of_a_mirror_image_is_the_action_itself(actions) -> None:
    config = EnvConfig(actions=actions)
    mirror, space = ActionMirror(config), config.action_space()
    space.seed(0)
    given, right = np.array([space.sample() for _ in range(40)]), np.full(40, -1.0, np.float32)
    image = mirror(given, right)
    assert (image != given).any()
    np.testing.assert_array_equal(mirror(image, right), given)
    np.testing.assert_array_equal(mirror(given, -right), given)


def test_mirror_images_of_orientations() -> None:
    np.testing.assert_array_equal(EnvConfig().images, [0, 2, 1, 3])
    eight = tuple(np.arange(8) * math.pi / 8)
    images = EnvConfig(orientations=eight).images
    np.testing.assert_array_equal(images, [0, 7, 6, 5, 4, 3, 2, 1])
    with pytest.raises(ValueError, match="orientations"):
        _ = EnvConfig(orientations=(0.0, math.pi / 4)).images


def test_a_vec_env_in_the_mirror_knows_the_side_of_each_start() -> None:
    """Axes at -45 deg everywhere sort to either side."""
    envs = make_mirrored_envs(DQNConfig(num_envs=64, camera_share=0.0))
    envs.seed(0)
    envs.reset()
    ends: dict[float, int] = {1.0: 0, -1.0: 0, 0.0: 0}
    for _ in range(60):
        _, _, dones, infos = envs.step(np.full(64, 10))
        for i in np.nonzero(dones)[0]:
            assert infos[i]["outcome"] != "wrong side"
            ends[float(infos[i]["terminal_observation"][SIDE])] += infos[i]["is_success"]
    assert min(ends[1.0], ends[-1.0]) > 5
