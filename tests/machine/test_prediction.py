"""Predictions of logged runs, beside `simulate` and beside an environment's kernel."""

from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.layouts import ROLLING
from surface_gym.machine import prediction as pr
from surface_gym.machine.estimate import PARAMETERS
from surface_gym.machine.log import LoggedRun
from surface_gym.machine.search import column_of
from tests.machine.recorded import BOX, HIDDEN, SITE, SURFACE, recorded

TIME = np.linspace(0.0, 0.8, 41)
LOADED = replace(BOX, com_height=0.03, com_offset=(0.02, -0.01))  # too low to tip
ENTRY = (0.4, 1.01, 0.1, 1.4, 0.02, 0.3)


def run(axes: np.ndarray, sent: np.ndarray) -> LoggedRun:
    poses = np.column_stack([0.4 + 1.2 * TIME, np.ones(41), np.zeros(41)])
    return LoggedRun(LOADED, 0.0, SITE.rotor, TIME, poses, sent, axes, acknowledged=True)


def predict(given: LoggedRun, dt: float, **values: float) -> np.ndarray:
    """Poses (frames, 3) of a run by parameters."""
    row = np.zeros((1, pr.VALUES))
    row[0, pr.ENTRY :] = ENTRY
    assumed = {"mu_max": 0.5, "mu_min": 0.01, "mu_support": 0.005, "quarter_turn": 1e-4}
    for name, value in {**assumed, **values}.items():
        row[0, column_of(name)] = value
    poses = np.empty((len(given.taken), 3))
    runs, memory = pr.pack_runs(SURFACE, [given]), pr.make_memory(SURFACE)
    first = np.array([0, len(poses)])
    pr.predict_runs(runs, np.zeros(1, dtype=np.int64), row, first, memory, poses, dt)
    return poses


@pytest.mark.parametrize("angle", [ROLLING, 0.0, 0.25 * np.pi, -0.3])
def test_with_axes_that_stay_it_is_a_simulation(angle: float) -> None:
    axis = np.full(SITE.rotor.shape, angle)
    surface = sg.Surface(axis, SITE.rotor, tilt=0.05)
    x, y, *others = ENTRY
    trajectory = sg.simulate(surface, LOADED, (x, y, others[0]), tuple(others[1:]), 0.8, dt=2e-5)
    given = run(axis[np.newaxis], np.array([-1.0]))
    poses = predict(given, 1e-3, tilt=0.05, com_x=0.02, com_y=-0.01)
    times = np.round(TIME / 2e-5).astype(int)
    expected = trajectory.pose[times]
    np.testing.assert_allclose(poses[:, :2], expected[:, :2], atol=3e-4)
    np.testing.assert_allclose(poses[:, 2], expected[:, 2], atol=2e-3)


def test_turning_axes_converge_with_the_step() -> None:
    axes = sg.excitation(SITE.rotor.shape, 0.8, run=2)
    given = run(axes, 0.04 * np.arange(len(axes)) + 0.013)
    fine = predict(given, 1e-4, quarter_turn=0.07, latency=0.004)
    for dt, most in ((4e-3, 3e-3), (1e-3, 6e-4)):
        coarse = predict(given, dt, quarter_turn=0.07, latency=0.004)
        assert np.abs(coarse - fine)[:, :2].max() < most


def test_latency_moves_commands_and_dead_time_moves_them_alike() -> None:
    axes = sg.excitation(SITE.rotor.shape, 0.8, run=1)
    sent = 0.04 * np.arange(len(axes))
    late = predict(run(axes, sent), 1e-3, latency=0.011)
    np.testing.assert_array_equal(predict(run(axes, sent), 1e-3, dead_time=0.011), late)
    np.testing.assert_allclose(predict(run(axes, sent + 0.011), 1e-3), late, atol=1e-9)
    assert np.abs(late - predict(run(axes, sent), 1e-3)).max() > 1e-3


def test_a_parcel_beyond_the_surface_stays() -> None:
    given = replace(run(np.zeros((0, *SITE.rotor.shape)), np.zeros(0)), taken=5.0 * TIME)
    poses = predict(given, 5e-3, tilt=0.3)
    assert np.isfinite(poses).all()
    np.testing.assert_array_equal(poses[-1], poses[-2])


def test_the_truth_explains_the_pictures_of_an_environment() -> None:
    """The environment's kernel made the log, in steps of 0.1 ms."""
    log = recorded(runs=6, seconds=0.6)
    found = sg.identify(
        [log], free=["mu_max"], noise=(0.002, np.radians(0.5)),
        known={name: getattr(HIDDEN, name) for name in PARAMETERS
               if name not in ("mu_max", "dead_time")},
    )  # fmt: skip
    assert found.is_explained
    assert found.misfit == pytest.approx(1.0, abs=0.15)
    assert found.values["mu_max"] == pytest.approx(HIDDEN.mu_max, abs=0.02)
