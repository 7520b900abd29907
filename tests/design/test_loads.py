"""The largest load of a module, beside another solver of Eq. (1) along a run."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.design import Case, StopPurpose, Unknown, module_loads
from surface_gym.design.case import NOMINAL, NOTHING, TOGETHER
from surface_gym.physics.references import scipy_normal_forces
from surface_gym.physics.types import GRAVITY
from tests.environments import outside

PARCEL = sg.Parcel(sg.Rectangle(0.3, 0.4), mass=12.0, com_height=0.2, com_offset=(0.02, -0.03))
FAST = pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")


def turn(angle: float) -> np.ndarray:
    """The matrix of a turn [rad]."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def independent_load(case: Case, found) -> float:
    """The largest load [kg] of a rotor in a run by `simulate`, with the loads by SciPy."""
    arrangement, dt = found.arrangement, case.step
    line = arrangement.line
    surface = line.surface(arrangement.layout.axis, case.tilt)
    run = sg.simulate(
        surface, case.parcel, line.start(case.parcel), (case.speed, 0.0, 0.0), 20.0, dt
    )
    x, y = np.meshgrid(surface.x, surface.y)
    largest, com, before = 0.0, np.array(case.parcel.centre_of_mass), None
    for pose, velocity in zip(run.pose[:-1], run.velocity[:-1], strict=True):
        omega, arm = velocity[2], turn(pose[2]) @ com
        rate = velocity[:2] + omega * np.array([-arm[1], arm[0]])
        centre, turned = pose[:2] + arm + 0.5 * dt * rate, pose[2] + 0.5 * dt * omega
        ahead = (*(centre - turn(turned) @ com), turned)  # where a step finds its contacts
        under = outside(case.parcel.base, ahead, x, y) <= 1e-9
        if not (under & surface.rotor).any():
            break
        arms = np.stack([x[under] - centre[0], y[under] - centre[1]], axis=1)
        change = np.zeros(2) if before is None else (rate - before) / dt
        load = -case.parcel.com_height / GRAVITY * change
        forces, _ = scipy_normal_forces(arms, GRAVITY, load)
        largest = max(largest, forces[surface.rotor[under]].max())
        before = rate
    return case.parcel.mass * largest / GRAVITY


@FAST
@pytest.mark.parametrize("speed", [1.2, 2.0])
def test_it_is_that_of_another_solver_along_a_run(speed):
    case = Case(PARCEL, speed=speed, unknown=NOTHING)
    found = module_loads(case, columns=8)
    assert found.load() == pytest.approx(independent_load(case, found), rel=1e-5)
    assert found.load() > 12.0 / 12  # more than an even share of twelve contacts


def test_it_grows_with_the_mass_and_the_heaviest_parcel_meets_the_limit():
    unknown = Unknown(stiffness=0.3, com_offset=0.1)
    light = module_loads(Case(PARCEL, draws=20, unknown=unknown), columns=6)
    mass = light.heaviest(TOGETHER)
    heavy_parcel = sg.Parcel(PARCEL.base, mass, PARCEL.com_height, com_offset=PARCEL.com_offset)
    heavy = module_loads(Case(heavy_parcel, draws=20, unknown=unknown), columns=6)
    assert heavy.load(TOGETHER) == pytest.approx(20.0, rel=1e-9)
    assert light.load(TOGETHER) > light.load(NOMINAL)
    assert not light.overloaded
    assert mass > light.heaviest(TOGETHER) - 1e-9
    assert light.heaviest(NOMINAL) > mass


def test_an_even_load_at_rest_is_shared_evenly():
    """A square on 2 x 2 rotors and nothing else: a quarter each, whatever its speed."""
    parcel = sg.Parcel(sg.Rectangle(0.19, 0.19), mass=8.0, com_height=0.0)
    case = Case(parcel, StopPurpose(), speed=0.05, unknown=NOTHING, mu_min=0.3)
    found = module_loads(case, columns=3, rows=2)
    assert found.load() <= 4.0 + 1e-9  # on two of them
    assert found.load() >= 2.0 - 1e-9


def test_it_is_named_in_the_answer():
    case = Case(PARCEL, unknown=NOTHING)
    assert "OVERLOADED" in module_loads(case, columns=6, limit=0.5).sentence
    fine = module_loads(case, columns=6)
    assert "OVERLOADED" not in fine.sentence
    assert "A module bears 20 kg" in fine.sentence
    (table,) = fine.tables()
    assert table.rows[0][1:] == (fine.load(), fine.heaviest(), 1.0)


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan, "20", None])
def test_a_bad_limit_is_named(limit):
    with pytest.raises(ValueError, match=r"^limit must"):
        module_loads(Case(PARCEL, unknown=NOTHING), columns=6, limit=limit)
