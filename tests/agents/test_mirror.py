"""The mirror: what sorts to y > 0 sorts, mirrored, to y < 0."""

import math

import numpy as np
import pytest

import surface_gym as sg
from agents.mirror import SIDE, ActionMirror, mirrored_orientations
from surface_gym.actions import KINDS
from surface_gym.settings import ORIENTATIONS, Settings


@pytest.mark.parametrize("actions", KINDS)
@pytest.mark.parametrize("parcel", ["S", "B"])
def test_trajectories_are_mirror_images(actions: str, parcel: str) -> None:
    settings = Settings(actions=actions)
    mirror = ActionMirror(settings.action_kind, settings.orientations)
    env = sg.SmartSurfaceVectorEnv(2, actions=actions)
    start = {"speed": 1.2, "parcel": parcel}
    observations, _ = env.reset(seed=0, options=[{**start, "side": 1}, {**start, "side": -1}])
    env.single_action_space.seed(1)
    for _ in range(8):
        seen = np.delete(observations, SIDE, axis=1)
        np.testing.assert_allclose(seen[0], seen[1], atol=1e-5)
        one = env.single_action_space.sample()
        both = np.array([one, one])
        observations, *_, info = env.step(mirror(both, np.array([1.0, -1.0], dtype=np.float32)))
        pose = info["pose"]
        assert pose[0, 0] == pytest.approx(pose[1, 0], abs=1e-9)
        assert pose[0, 1] - 1.0 == pytest.approx(1.0 - pose[1, 1], abs=1e-9)
        assert pose[0, 2] == pytest.approx(-pose[1, 2], abs=1e-9)


def test_mirror_images_of_orientations() -> None:
    np.testing.assert_array_equal(mirrored_orientations(ORIENTATIONS), [0, 2, 1, 3])
    with pytest.raises(ValueError, match="orientations"):
        mirrored_orientations((0.0, math.pi / 4))
