"""Runs of Section 5: columns under a box, and steps in which Eq. (1) has no solution."""

import numpy as np
import pytest
from scipy.optimize import linprog

from surface_gym import layouts
from surface_gym.paper import runs
from surface_gym.paper.runs import COARSE, NONE, SlowingLayout, rotor_columns, tipping_share
from surface_gym.trajectory import Trajectory
from tests.environments import outside

GRAVITY = 9.81
HEIGHT = 0.1  # [m] of the centre of mass


def missed_moments(surface, pose, acceleration):
    """[m] by how much no forces N >= 0 of the given sum meet the moments of Eq. (1)."""
    x, y = np.meshgrid(surface.x, surface.y)
    under = outside(layouts.box("S").base, pose, x, y) <= 0.0
    arms = np.stack([x[under] - pose[0], y[under] - pose[1]])
    load = -HEIGHT * np.array(acceleration) / GRAVITY
    count = arms.shape[1]
    # Shares of the weight, and the largest miss, which is made small.
    bounds = np.block([[arms, -np.ones((2, 1))], [-arms, -np.ones((2, 1))]])
    loads, sums = np.concatenate([load, -load]), np.append(np.ones(count), 0.0)[np.newaxis]
    return linprog(np.append(np.zeros(count), 1.0), bounds, loads, sums, [1.0]).fun


@pytest.mark.parametrize("integration", [COARSE, runs.Integration("implicit", 5e-3)], ids=str)
def test_a_box_tips_where_no_forces_carry_it(integration):
    surface = runs.slowing_surface("S", SlowingLayout(2, 0))
    run = integration.run(surface, "S", 1.5, 0.4)
    lead = 0.5 * integration.dt if integration.method == "implicit" else 0.0
    compared = tips = 0
    for k in range(1, len(run.time) - 1):
        acceleration = (run.velocity[k] - run.velocity[k - 1]) / integration.dt
        missed = missed_moments(surface, run.pose[k] + lead * run.velocity[k], acceleration[:2])
        if 1e-9 < missed < 1e-4:
            continue  # on the very rim of what the rotors can carry
        assert run.tipping[k + 1] == (missed > 1e-6)
        compared += 1
        tips += missed > 1e-6
    assert compared > 60
    assert tips > 5


def test_the_share_counts_the_steps_up_to_a_row():
    tipping = np.array([False, True, True, False, False])
    run = Trajectory(np.arange(5.0), np.zeros((5, 3)), np.zeros((5, 3)), tipping, "duration")
    assert tipping_share(run) == 0.5
    assert tipping_share(run, 3) == pytest.approx(2.0 / 3.0)
    assert tipping_share(run, 0) is None


def test_much_of_the_tipping_is_chatter(reproduction):
    """A rotor across the motion that chatters throws the load to the rim of the two rows."""
    table = reproduction.table("table4")
    coarse, _, smooth = (table.tipping(k)["S"] for k in range(3))
    assert coarse[0] > 0.08
    assert smooth[0] < 0.03
    assert 0.1 < smooth[1] < coarse[1] < 0.2
    assert runs.SMOOTH.method == "implicit"
    assert table.tipping(0)["B"] == (0.0, 0.0)


def columns_by_base_functions(surface, size, pose):
    """Section 3.2's F_lambda <= 0, asked of every rotor of the surface."""
    x, y = np.meshgrid(surface.x, surface.y)
    inside = outside(layouts.box(size).base, pose, x, y) <= 0.0
    columns = np.nonzero(inside & surface.rotor)[1]
    return (columns.min(), columns.max()) if len(columns) else (NONE, NONE)


def test_columns_are_those_of_the_rotors_inside_the_base_and_none_at_the_start():
    rng = np.random.default_rng(7)
    pose = rng.uniform([0.2, 0.5, -np.pi], [1.5, 1.5, np.pi], size=(300, 3))
    for size in ("S", "B"):
        surface = layouts.sorting(size)
        first, last = rotor_columns(surface, size, pose)
        expected = [columns_by_base_functions(surface, size, row) for row in pose]
        assert np.stack([first, last], axis=-1).tolist() == [list(map(int, e)) for e in expected]
        assert (last == NONE).any()
        assert (last != NONE).any()
    for size, lead_in in layouts.LEAD_IN.items():
        _, last = rotor_columns(layouts.sorting(size), size, np.array([layouts.start(size)]))
        assert last[0] < lead_in
