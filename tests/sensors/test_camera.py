"""The camera: frames, noise, latency, drops, and what the filter makes of them."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.sensors import Camera, Entry, Presence
from surface_gym.sensors.camera import FRAME_SIZE, FRAMES, TAKEN
from surface_gym.sensors.kalman import LAST
from tests.sensors.runs import BRAKE, PLUS_45, ROLL, all_say, errors, rms

SURE = Entry(position=0.0, angle=0.0, speed=0.0, turning=0.0)


def test_without_noise_and_latency_it_shows_the_truth_at_frame_times() -> None:
    sharp = Camera(frame_rate=25.0, latency=0.0, position_noise=1e-9, angle_noise=1e-9)
    apart = np.abs(errors(sharp, PLUS_45, speed=1.5, parcel="S"))
    assert apart[:, :3].max() < 1e-6  # a frame falls on every decision


@pytest.mark.parametrize("late", [0, 1, 2, 5])
def test_a_jump_is_seen_after_the_latency_and_not_before(late: int) -> None:
    """The parcel is put elsewhere by hand; the filter then leaves its old course."""
    period = 0.02
    camera = Camera(
        frame_rate=50.0, latency=late * period, position_noise=1e-4, angle_noise=1e-4, entry=SURE,
        acceleration_density=10.0,
    )  # fmt: skip
    batch = Batch(EnvConfig(actions="halves", sensors=camera, control_period=period), 1)
    batch.reset_cache.seed(0, np.random.default_rng(0))
    batch.reset(np.zeros(1, dtype=np.int64), [{"speed": 0.5, "parcel": "S", "side": 1}])
    roll = np.full((1, 2), ROLL)
    for _ in range(8):
        batch.step(roll)
    batch.parcels.state[0, 1] += 0.05
    for periods in range(1, late + 2):
        batch.step(roll)
        seen = batch.parcels.sensed[0, 1] - 1.0
        # The first frame after the jump is that at the end of this period.
        assert (abs(seen) > 0.005) == (periods > late), (periods, seen)


def test_noise_has_its_law() -> None:
    """So noisy an acceleration that the filter believes each frame: its error is the frame's."""
    blunt = Camera(
        frame_rate=25.0, latency=0.0, position_noise=0.004, angle_noise=0.02,
        acceleration_density=1e6, turn_density=1e6,
    )  # fmt: skip
    found = errors(blunt, ROLL, num_envs=64, speed=1.0, parcel="S")
    assert len(found) > 1500
    for column, spread in ((0, 0.004), (1, 0.004), (2, 0.02)):
        assert found[:, column].std() == pytest.approx(spread, rel=0.08)
        assert abs(found[:, column].mean()) < 4.0 * spread / math.sqrt(len(found))


def test_a_start_is_known_as_the_entry_says_and_no_noise_comes_twice() -> None:
    """A filter that believes each frame, one a step: errors of the start and of five frames."""
    blunt = Camera(
        frame_rate=25.0, latency=0.0, acceleration_density=1e6, turn_density=1e6,
        entry=Entry(position=0.004, angle=0.03, speed=0.2, turning=0.7),
    )  # fmt: skip
    env = sg.SmartSurfaceVectorEnv(512, actions="halves", sensors=blunt)
    env.reset(seed=0, options={"side": 1, "speed": 1.0, "parcel": "S"})
    memory = env.batch.parcels
    found = [memory.sensed - memory.truth]
    np.testing.assert_allclose(found[0].std(axis=0), (0.004, 0.004, 0.03, 0.2, 0.2, 0.7), rtol=0.1)
    for _ in range(5):
        env.step(all_say(env, ROLL))
        found.append(memory.sensed - memory.truth)
    of_poses = np.concatenate(found[1:], axis=1)
    alike = np.corrcoef(np.hstack([found[0], of_poses[:, np.arange(30) % 6 < 3]]).T)
    assert np.abs(alike - np.eye(len(alike))).max() < 0.25


@pytest.mark.parametrize("drop", [0.0, 0.3, 0.7])
def test_frames_are_lost_with_the_probability_asked(drop: float) -> None:
    camera = Camera(frame_rate=50.0, latency=0.0, drop=drop)
    env = sg.SmartSurfaceVectorEnv(64, actions="halves", sensors=camera)
    env.reset(seed=0, options={"speed": 0.5, "parcel": "S"})
    taken = []
    for _ in range(20):
        env.step(all_say(env, ROLL))
        memory = env.batch.parcels
        frames = memory.sensor_state[:, LAST:].reshape(64, FRAMES, FRAME_SIZE)
        newest = (memory.steps // 4) % FRAMES
        taken.append(frames[np.arange(64), newest, TAKEN] > 0)
    assert np.mean(taken) == pytest.approx(1.0 - drop, abs=0.05)


def test_the_default_camera_on_sorts_and_brakes() -> None:
    for choice, parcel in ((PLUS_45, "S"), (BRAKE, "B")):
        found = rms(errors(Camera(), choice, speed=1.5, parcel=parcel))
        assert (found[:2] < 0.0015).all()
        assert found[2] < math.radians(0.6)
        assert (found[3:5] < 0.04).all()  # while braking takes 0.2 m/s a period


def test_late_frames_do_no_harm_to_a_filter_that_knows_the_physics() -> None:
    """Compared with what was estimated of their time, they say the same a little later."""
    for latency in (0.0, 0.02, 0.08):
        camera = Camera(latency=latency, position_noise=1e-4, angle_noise=1e-4, entry=SURE)
        found = np.abs(errors(camera, PLUS_45, speed=1.5, parcel="S"))
        assert found[:, :2].max() < 1e-3
        assert found[:, 3:5].max() < 2e-2


def test_friction_unlike_the_assumed_one_is_made_up_for_by_the_frames() -> None:
    slippery = rms(errors(Camera(mu_max=0.3), BRAKE, speed=2.0, parcel="S"))
    assert slippery[0] < 0.01
    assert slippery[3] < 0.2
    # It beats the raw frames.
    assert rms(errors(Camera(position_noise=0.005), ROLL, speed=1.0, parcel="S"))[0] < 0.0047


BAD: dict[str, Any] = {
    "frame_rate": 0.0, "latency": 1.0, "position_noise": -1e-3, "angle_noise": -1e-3,
    "mu_max": -0.5, "mu_min": -0.01, "mu_support": math.inf, "friction_error": -0.1, "drop": 1.0,
    "acceleration_density": 0.0, "turn_density": -1.0, "entry": None,
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_fields_are_named(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Camera(**{name: BAD[name]})


@pytest.mark.parametrize(("kind", "name"), [(Camera, "frame_rate"), (Presence, "sample_rate")])
def test_what_is_faster_than_physics_steps_is_refused(kind: Any, name: str) -> None:
    with pytest.raises(ValueError, match=name):
        sg.SmartSurfaceEnv(sensors=kind(**{name: 1000.0}))
