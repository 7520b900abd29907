"""What a filter learns of friction and load: by the physics' own derivatives, and for good."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.sensors import AdaptiveCamera, Camera
from surface_gym.sensors.base import LEARNED
from surface_gym.sensors.camera import SPREADS
from surface_gym.sensors.kalman import CONSTANT, DECAY, DOUBT, EFFECT
from surface_gym.tasks import Slow
from tests.sensors.runs import BRAKE, ROLL, errors, rms

HALVES = {"all brake": (BRAKE, BRAKE), "ahead brakes": (BRAKE, ROLL), "aside and back": (2, 1)}


def in_the_zone(axes: tuple[int, ...]) -> Batch:
    """A parcel in the middle of its zone, its rotors set; a period is one physics step, and no
    frame comes.
    """
    unseen = AdaptiveCamera(frame_rate=0.1)
    batch = Batch(EnvConfig("slow", actions="halves", sensors=unseen, control_period=0.005), 1)
    batch.reset_cache.seed(0, np.random.default_rng(0))
    batch.reset(np.zeros(1, dtype=np.int64), [{"speed": 2.0, "parcel": "B"}])
    for _ in range(104):
        batch.step(np.full((1, 2), ROLL))
    batch.step(np.array([axes]))
    return batch


@pytest.mark.parametrize("axes", HALVES.values(), ids=HALVES)
def test_effects_are_the_derivatives_of_a_step(axes: tuple[int, ...]) -> None:
    """Against central differences of the physics' step over each of the constants."""
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
    assert (rms(errors(learning, BRAKE, speed=1.5, parcel="B")) < 1.5 * plain).all()


@pytest.mark.parametrize("name", ["friction_spread", "load_spread"])
def test_the_spreads_are_checked_and_where_the_filter_reads_them(name: str) -> None:
    for value in (0.0, -0.1, float("nan"), 2.0, "wide"):
        with pytest.raises(ValueError, match=rf"^{name} must be"):
            AdaptiveCamera(**{name: value})
    numbers = AdaptiveCamera(friction_spread=0.2, load_spread=0.03).numbers(0.005)
    assert numbers[SPREADS:] == (0.2, 0.03)
