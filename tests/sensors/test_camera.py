"""The cameras: frames, noise, latency, drops, what the filter makes of them, and what an adaptive
one learns of friction and load: by the physics' own derivatives, and for good.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.sensors import AdaptiveCamera, Camera, Entry, Presence
from surface_gym.sensors.base import LEARNED
from surface_gym.sensors.camera import FRAME_SIZE, FRAMES, SPREADS, TAKEN
from surface_gym.sensors.kalman import CONSTANT, DECAY, DOUBT, EFFECT, LAST
from surface_gym.tasks import Slow
from tests.environments import begun
from tests.flow import flows
from tests.sensors.runs import BRAKE, PLUS_45, ROLL, all_say, errors, rms

SURE = Entry(position=0.0, angle=0.0, speed=0.0, turning=0.0)


def test_without_noise_and_latency_it_shows_the_truth_at_frame_times() -> None:
    sharp = Camera(frame_rate=25.0, latency=0.0, position_noise=1e-9, angle_noise=1e-9)
    apart = np.abs(errors(sharp, PLUS_45, speed=1.5, parcel="S"))
    assert apart[:, :3].max() < 1e-6  # a frame falls on every decision


@pytest.mark.parametrize("late", [0, 1, 2, 5])
def test_a_jump_is_seen_after_the_latency_and_not_before(late: int) -> None:
    period = 0.02
    camera = Camera(
        frame_rate=50.0, latency=late * period, position_noise=1e-4, angle_noise=1e-4, entry=SURE,
        acceleration_density=10.0,
    )  # fmt: skip
    config = EnvConfig(actions="halves", sensors=camera, control_period=period)
    batch = begun(config, options=[{"speed": 0.5, "parcel": "S", "side": 1}])
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
    for latency in (0.0, 0.02, 0.08):
        camera = Camera(latency=latency, position_noise=1e-4, angle_noise=1e-4, entry=SURE)
        found = np.abs(errors(camera, PLUS_45, speed=1.5, parcel="S"))
        assert found[:, :2].max() < 1e-3
        assert found[:, 3:5].max() < 2e-2


@pytest.mark.parametrize("tilt_direction", [0.0, math.pi / 2, -2.0])
def test_between_frames_the_filter_moves_a_parcel_down_a_slope_as_physics_does(
    tilt_direction: float,
) -> None:
    blind = Camera(frame_rate=0.01, latency=0.0, entry=SURE)
    stream = flows.trace((0.0, "straight"))
    batch = flows.batch_with(
        stream, sensors=blind, actions="parcels", tilt=0.08, tilt_direction=tilt_direction,
        actuators=sg.Actuators(axis_speed=1e3),
    )  # fmt: skip
    for _ in range(15):
        batch.step(flows.command(batch, PLUS_45))
    parcels = batch.parcels
    assert parcels.truth[0, 0] > 0.7
    np.testing.assert_allclose(parcels.sensed[0], parcels.truth[0], rtol=0.0, atol=1e-9)


def test_friction_unlike_the_assumed_one_is_made_up_for_by_the_frames() -> None:
    slippery = rms(errors(Camera(mu_max=0.3), BRAKE, speed=2.0, parcel="S"))
    assert slippery[0] < 0.01
    assert slippery[3] < 0.2
    # It beats the raw frames.
    assert rms(errors(Camera(position_noise=0.005), ROLL, speed=1.0, parcel="S"))[0] < 0.0047


@pytest.mark.parametrize(("kind", "name"), [(Camera, "frame_rate"), (Presence, "sample_rate")])
def test_what_is_faster_than_physics_steps_is_refused(kind: Any, name: str) -> None:
    with pytest.raises(ValueError, match=name):
        sg.SmartSurfaceEnv(sensors=kind(**{name: 1000.0}))


HALVES = {"all brake": (BRAKE, BRAKE), "ahead brakes": (BRAKE, ROLL), "aside and back": (2, 1)}


def in_the_zone(axes: tuple[int, ...]) -> Batch:
    """A parcel in the middle of its zone, its rotors set; a period is one physics step, and no
    frame comes.
    """
    unseen = AdaptiveCamera(frame_rate=0.1)
    config = EnvConfig(
        "slow", actions="halves", sensors=unseen, control_period=0.005, observe=("load",)
    )
    batch = begun(config, options=[{"speed": 2.0, "parcel": "B"}])
    for _ in range(104):
        batch.step(np.full((1, 2), ROLL))
    batch.step(np.array([axes]))
    return batch


@pytest.mark.parametrize("axes", HALVES.values(), ids=HALVES)
def test_effects_are_the_derivatives_of_a_step(axes: tuple[int, ...]) -> None:
    batch = in_the_zone(axes)
    kept = batch.parcels.sensor_state[0]
    kept[2] = 0.3  # rad: so that base and world differ
    kept[5] = -0.8  # rad/s: so that arms count
    kept[6:8] = 0.0
    before = tuple(array.copy() for array in batch.parcels)

    def velocities(constants: np.ndarray) -> np.ndarray:
        for array, values in zip(batch.parcels, before, strict=True):
            array[:] = values
        kept[CONSTANT : CONSTANT + LEARNED] = constants
        batch.step(np.array([axes]))
        return kept[3:6].copy()

    constants = np.array([1.1, 0.02, -0.015])
    differences = np.empty((3, LEARNED))
    for k, step in enumerate((1e-4, 1e-5, 1e-5)):
        apart = step * np.eye(LEARNED)[k]
        differences[:, k] = velocities(constants + apart) - velocities(constants - apart)
        differences[:, k] /= 2.0 * step
    velocities(constants)
    effect = kept[EFFECT : EFFECT + 9].reshape(3, 3)
    # What is held rather than sliding takes less of a change: `effect` is damped alike.
    assert np.abs(np.linalg.eigvals(kept[DECAY : DECAY + 9].reshape(3, 3))).min() > 0.9
    np.testing.assert_allclose(effect, differences, atol=0.05 * float(np.abs(differences).max()))


def after_braking(sensors: Camera, num_envs: int = 128) -> tuple[Any, sg.SmartSurfaceVectorEnv]:
    """What a filter has in mind of parcels of the lab that were braked and led aside a little."""
    lab = replace(PRESETS["lab"], sensors=sensors, actuators=sg.Actuators())
    env = sg.SmartSurfaceVectorEnv(
        num_envs, Slow(speeds=(2.0, 2.4)), actions="halves", preset=lab, observe=("load",)
    )
    observation, _ = env.reset(seed=3)
    patterns = ((BRAKE, ROLL), (ROLL, BRAKE), (BRAKE, BRAKE))
    for k in range(16):
        pattern = (ROLL, ROLL) if k < 7 else patterns[k % 3]
        action = env.config.action_kind.encode(np.tile(pattern, (num_envs, 1)))
        observation, _, terminated, truncated, _ = env.step(action)
        assert not (terminated | truncated).any()
    return observation, env


def test_friction_and_load_are_learned_as_well_as_it_says() -> None:
    """Errors over the filter's own doubts are of order one, and doubts have shrunk."""
    sensors = PRESETS["lab"].sensors
    assert isinstance(sensors, AdaptiveCamera)
    observation, env = after_braking(sensors)
    batch = env.batch
    bodies = batch.bodies.body[batch.parcels.body]
    true = np.column_stack([batch.surfaces.conditions[:, 0], bodies[:, 1], bodies[:, 2]])
    kept = batch.parcels.sensor_state
    wrong = kept[:, CONSTANT : CONSTANT + LEARNED] - true
    doubts = np.sqrt(kept[:, DOUBT : DOUBT + 9 : LEARNED + 1])
    spreads = np.array([sensors.friction_spread, sensors.load_spread, sensors.load_spread])
    assert (doubts.mean(axis=0) < (0.6, 0.9, 0.7) * spreads).all()
    prior = true - (1.0, 0.0, 0.0)
    assert (rms(wrong) < rms(prior)).all()
    over = rms(wrong / doubts)
    assert ((over > 0.3) & (over < 2.0)).all(), over
    # The observation shows the same, over what was known before.
    shown = np.column_stack([(kept[:, CONSTANT : CONSTANT + LEARNED] - (1, 0, 0)), doubts])
    np.testing.assert_allclose(
        observation[:, -2 * LEARNED :], shown / np.tile(spreads, 2), rtol=1e-5, atol=1e-6
    )


def test_it_sees_better_in_the_lab_than_a_camera_that_does_not_learn() -> None:
    lab = PRESETS["lab"].sensors
    assert isinstance(lab, AdaptiveCamera)
    plain = Camera(
        latency=lab.latency, position_noise=lab.position_noise, entry=lab.entry, friction_error=0.1
    )
    found = []
    for sensors in (lab, plain):
        observation, env = after_braking(sensors)
        memory = env.batch.parcels
        found.append(rms((memory.sensed - memory.truth)[:, 3:]))
    assert (found[0] < (0.85, 0.85, 0.6) * found[1]).all(), found
    # A sensor that does not learn shows all doubt.
    np.testing.assert_array_equal(observation[:, -6:], [[0, 0, 0, 1, 1, 1]] * len(observation))


def test_where_all_is_as_assumed_it_sees_as_well_as_a_camera() -> None:
    plain = rms(errors(Camera(), BRAKE, speed=1.5, parcel="B"))
    learning = AdaptiveCamera(acceleration_density=0.0003, turn_density=0.03)
    found = rms(errors(learning, BRAKE, speed=1.5, parcel="B"))
    assert (found < 1.5 * plain).all()


@pytest.mark.parametrize("name", ["friction_spread", "load_spread"])
def test_the_spreads_are_checked_and_where_the_filter_reads_them(name: str) -> None:
    for value in (0.0, -0.1, float("nan"), 2.0, "wide"):
        with pytest.raises(ValueError, match=rf"^{name} must be"):
            AdaptiveCamera(**{name: value})
    numbers = AdaptiveCamera(friction_spread=0.2, load_spread=0.03).numbers(0.005)
    assert numbers[SPREADS:] == (0.2, 0.03)
