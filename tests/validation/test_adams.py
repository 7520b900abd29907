"""Adams's displacements out of its printed errors."""

import numpy as np

from surface_gym.validation.adams import printed


def test_a_displacement_is_the_error_over_its_share():
    tilted, pushed = printed("gamma10"), printed("v09")

    for found, errors, percents in (
        (tilted, (0.0011, 0.0001, 1.735), (0.24, 0.05, 7.06)),
        (pushed, (0.003, 0.0037, 1.56), (0.65, 1.59, 6.97)),
    ):
        middle = 100.0 * np.array(errors) / np.array(percents)
        assert (found.low < middle).all()
        assert (middle < found.high).all()


def test_its_bounds_are_those_of_rounding():
    """1.735 deg stands for 1.7345 to 1.7355, 7.06 % for 7.055 to 7.065."""
    tilted = printed("gamma10")

    np.testing.assert_allclose(tilted.low[2], 100.0 * 1.7345 / 7.065)
    np.testing.assert_allclose(tilted.high[2], 100.0 * 1.7355 / 7.055)


def test_mujoco_ends_where_adams_does_as_far_as_is_printed(tilted):
    x, y, theta = np.abs(tilted.mujoco.pose[-1] - tilted.mujoco.pose[0])
    found = printed("gamma10")

    assert found.low[0] < x < found.high[0]
    assert found.low[1] < y < found.high[1]
    assert abs(np.degrees(theta) - found.low[2]) < 2.0
