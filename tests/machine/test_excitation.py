"""Excitations brake and steer, and leave the parcel alone at first."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.layouts import ROLLING

QUARTER = 0.25 * np.pi


@pytest.mark.parametrize("run", [0, 1, 40])
def test_a_run_brakes_and_steers_to_both_sides(run: int) -> None:
    axes = sg.excitation((4, 16), 3.0, run=run)
    assert axes.shape == (75, 4, 16)
    assert (axes == axes[:, :1, :1]).all()
    assert set(np.unique(axes)) == {ROLLING, 0.0, QUARTER, -QUARTER}
    assert (axes[:5] == ROLLING).all()
    np.testing.assert_array_equal(axes, sg.excitation((4, 16), 3.0, run=run))


def test_runs_differ() -> None:
    one, other = (sg.excitation((1, 1), 2.0, run=run) for run in (1, 4))
    assert (one != other).any()


@pytest.mark.parametrize(
    "given", [{"shape": (0, 1)}, {"seconds": 0.0}, {"run": -1}, {"period": 0.0}]
)
def test_what_is_not_allowed_is_refused(given: dict) -> None:
    arguments = {"shape": (1, 1), "seconds": 1.0, **given}
    (name,) = given
    with pytest.raises(ValueError, match=name):
        sg.excitation(arguments.pop("shape"), arguments.pop("seconds"), **arguments)
