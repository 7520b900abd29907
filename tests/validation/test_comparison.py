"""Errors of Eq. (5), the paper's own numbers, and Adams's displacements out of them."""

import numpy as np
import pytest

from surface_gym.trajectory import Trajectory
from surface_gym.validation import comparison
from surface_gym.validation.comparison import Errors


def trajectory(*displacement: float) -> Trajectory:
    x, y, theta = displacement
    pose = np.array([[0.0, 0.0, 0.0], [x, y, np.radians(theta)]])
    return Trajectory(np.array([0.0, 1.0]), pose, np.zeros((2, 3)), np.zeros(2, bool), "duration")


def test_errors_are_those_of_eq_5_and_a_summary_is_mean_and_sample_deviation():
    mujoco, implicit = trajectory(0.5, -0.2, -20.0), trajectory(0.49, -0.21, -21.0)
    run = comparison.Run(comparison.PUSHED, mujoco, implicit, explicit=mujoco)
    error = comparison.compute_errors([run], lambda run: run.implicit)
    np.testing.assert_allclose(error.absolute, [[10.0, 10.0, 1.0]])
    np.testing.assert_allclose(error.percent, [[2.0, -5.0, -5.0]])
    rows = np.array([[1.0, 0.0, -1.0], [3.0, 0.0, -3.0]])
    summary = Errors(10.0 * rows, rows).summary("")
    np.testing.assert_allclose(summary.percent, [[2.0, 0.0, -2.0], [2**0.5, 0.0, 2**0.5]])
    np.testing.assert_allclose(summary.absolute, 10.0 * summary.percent)


def test_targets_take_the_worst_run_and_the_mean_of_the_sweep():
    absolute = np.array([[1.0, -2.0, 0.5], [-3.0, 1.0, 0.5]])
    sweep = Errors(absolute, np.array([[0.5] * 3, [-0.7] * 3]))
    pushed = Errors(np.array([[0.0, 6.0, 0.0]]), np.zeros((1, 3)))
    found = comparison.check_targets(sweep, pushed)
    measured = [target.measured for target in found]
    np.testing.assert_allclose(measured, [3.0, 6.0, 0.5, 0.7, 0.7, 0.7, 0.1, 0.1, 0.1])
    assert [target.what for target in found if not target.is_reached] == ["worst run in y"]


def test_the_papers_numbers_are_read_from_its_tables():
    paper = comparison.load_paper_errors()
    np.testing.assert_array_equal(paper.table7.percent, [[0.02, 1.41, -4.47], [0.44, 3.48, 4.36]])
    np.testing.assert_array_equal(paper.table7.absolute, [[0.12, 0.25, 0.96], [1.5, 5.2, 1.02]])
    np.testing.assert_allclose(paper.pushed.absolute, [[3.0, 3.7, 1.56]])
    assert paper.sorts_from == 9.5


def test_the_sort_completes_from_the_least_tilt_above_which_all_do(tilted):
    assert comparison.sorts_from([tilted], lambda run: run.mujoco) == 10.0
    stays = trajectory(0.0, 0.0, 0.0)
    stays.pose[:, :2] += tilted.mujoco.pose[0, :2]
    assert comparison.sorts_from([tilted], lambda _: stays) is None


@pytest.mark.parametrize(
    ("run", "errors", "percents"),
    [
        ("gamma10", (0.0011, 0.0001, 1.735), (0.24, 0.05, 7.06)),
        ("v09", (0.003, 0.0037, 1.56), (0.65, 1.59, 6.97)),
    ],
)
def test_a_displacement_of_adams_is_the_error_over_its_share(run, errors, percents):
    low, high = comparison.adams_displacement(run)
    exact = 100.0 * np.array(errors) / np.array(percents)
    assert (low < exact).all()
    assert (exact < high).all()
    if run == "gamma10":  # 1.735 deg stands for 1.7345 to 1.7355, 7.06 % for 7.055 to 7.065
        assert low[2] == pytest.approx(100.0 * 1.7345 / 7.065)
        assert high[2] == pytest.approx(100.0 * 1.7355 / 7.055)


def test_mujoco_ends_where_adams_does_as_far_as_is_printed(tilted):
    moved = np.abs(comparison.displacement(tilted.mujoco))
    low, high = comparison.adams_displacement("gamma10")
    assert (low < moved)[:2].all()
    assert (moved < high)[:2].all()
    assert abs(moved[2] - low[2]) < 2.0
