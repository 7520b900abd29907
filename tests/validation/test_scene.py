"""What the scene holds up, against Eq. (1) solved by SciPy."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import validation
from surface_gym.physics.references import scipy_normal_forces
from surface_gym.physics.types import GRAVITY
from surface_gym.validation import simulation
from surface_gym.validation.drawn import uneven_normal_forces
from surface_gym.validation.simulation import BASE, elements_under, reachable

pytestmark = pytest.mark.usefixtures("mujoco")
CENTRE = np.array([1.0, 1.0, 0.3])
ROTORS = np.arange(400).reshape(20, 20) % 3 == 0
SURFACE = sg.Surface(axis=np.full((20, 20), math.pi / 2), rotor=ROTORS)


def settled_forces(parcel, surface=SURFACE, heights=None):
    """(rows, columns) [N] under a parcel that stands still, and the depth [m] of its base."""
    import mujoco

    scene = validation.build(surface, parcel, heights=heights)
    data = mujoco.MjData(scene.model)
    turn = CENTRE[2] / 2.0
    data.qpos[:7] = *CENTRE[:2], 0.0, math.cos(turn), 0.0, 0.0, math.sin(turn)
    for _ in range(2000):
        mujoco.mj_step(scene.model, data)
    force = np.zeros(ROTORS.shape)
    for geoms, newton in zip(*simulation.normal_forces(data), strict=True):
        names = {scene.model.geom(geom).name for geom in geoms} - {BASE}
        row, column = map(int, names.pop().split(","))
        force[row, column] += newton
    return force, -data.qpos[2]


def arms_from_centre_of_mass(parcel):
    """The elements under the base, and the arms (n, 2) to them."""
    bearing = elements_under(SURFACE, parcel, CENTRE)
    c, s = math.cos(CENTRE[2]), math.sin(CENTRE[2])
    x, y = parcel.centre_of_mass
    centre_of_mass = np.array([c * x - s * y, s * x + c * y]) + CENTRE[:2]
    places = np.stack(np.meshgrid(SURFACE.x, SURFACE.y), axis=-1)
    return bearing, places[bearing] - centre_of_mass


@pytest.mark.parametrize(
    "parcel",
    [
        sg.Parcel(sg.Rectangle(0.25, 0.25), mass=5.48),
        sg.Parcel(sg.Rectangle(0.45, 0.25), mass=2.0, com_offset=(0.05, -0.03)),
        sg.Parcel(sg.Disc(0.2), com_offset=(0.02, 0.06)),
        sg.Parcel(sg.Polygon([[-0.2, -0.15], [0.2, -0.15], [0.0, 0.3]])),
    ],
    ids=["box", "off centre", "disc", "triangle"],
)
def test_springs_under_a_flat_base_share_its_weight_as_eq_1_does(parcel):
    force, _ = settled_forces(parcel)
    bearing, arms = arms_from_centre_of_mass(parcel)
    share, degenerate = scipy_normal_forces(arms, GRAVITY, np.zeros(2))
    assert not degenerate
    np.testing.assert_allclose(force[bearing], parcel.mass * share, rtol=1e-3, atol=1e-3)
    assert not force[~bearing].any()


def test_uneven_supports_share_it_as_the_extended_law_does():
    parcel = sg.Parcel(sg.Rectangle(0.45, 0.45), mass=5.48, com_offset=(0.02, 0.03))
    height, log_stiffness = np.random.default_rng(0).standard_normal((2, *ROTORS.shape))
    heights, stiffness = 1e-6 * height, np.exp(0.5 * log_stiffness)
    force, _ = settled_forces(parcel, replace(SURFACE, stiffness=stiffness), heights)
    bearing, arms = arms_from_centre_of_mass(parcel)
    springs = simulation.RECIPE.stiffness * stiffness[bearing]
    share = uneven_normal_forces(arms, heights[bearing], springs, GRAVITY, np.zeros(2))
    assert (share == 0.0).any()  # some hang free
    np.testing.assert_allclose(force[bearing], parcel.mass * share, rtol=0.01, atol=0.01)


def test_the_contact_stiffness_is_the_recipes():
    parcel = sg.Parcel(sg.Disc(0.15), mass=5.48)
    force, sag = settled_forces(parcel)
    stiffness = parcel.mass * GRAVITY / ((force > 0.0).sum() * sag)
    assert stiffness == pytest.approx(3e6, rel=0.01)


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
def test_only_what_is_within_reach_is_built_and_a_parcel_stays_within():
    parcel = sg.Parcel(sg.Rectangle(0.25, 0.25))
    within = reachable(SURFACE, parcel, (0.5, 0.5, 0.0), (0.3, 0.0, 0.0), 0.1)
    model = validation.build(SURFACE, parcel, within=within).model
    names = {model.geom(k).name for k in range(model.ngeom)} - {BASE}
    assert names == {f"{row},{column}" for row, column in np.argwhere(within)}
    assert model.nv == 6 + (within & ROTORS).sum()  # the parcel, and a hinge a rotor
    surface = sg.layouts.sorting(tilt=math.radians(14.0))
    parcel = sg.Parcel(sg.Rectangle(0.25, 0.25), com_offset=(0.1, 0.1))
    start, velocity = (0.5, 1.0, 0.0), (0.5, -0.5, 6.0)
    within = reachable(surface, parcel, start, velocity, 0.5)
    run = sg.simulate(surface, parcel, start, velocity, 0.5)
    assert not within.all()
    assert all(within[elements_under(surface, parcel, pose)].all() for pose in run.pose)


def test_what_cannot_be_built_is_refused():
    steep = sg.layouts.sorting(tilt=math.radians(16.0))
    masks = np.ones((70, 70), dtype=bool), np.zeros((210, 210), dtype=bool)
    large, wide = (sg.Surface(np.zeros(rotor.shape), rotor) for rotor in masks)
    for surface, more, message in (
        (steep, {}, "tilt must be between -15 and 15 deg.*got 16 deg"),
        (large, {}, "at most 4000 rotors .*got 4900 and"),
        (wide, {}, "at most 4000 rotors .*got 0 and"),
        (SURFACE, {"heights": np.zeros(3)}, r"heights must have the shape \(20, 20\), got \(3,\)"),
    ):
        with pytest.raises(ValueError, match=message):
            validation.build(surface, sg.Parcel(sg.Disc(0.1)), **more)


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (validation.Recipe, {"step": 0.0, "impedance": 1.0, "rotor_mass": math.nan}),
        (simulation.Sides, {"stiffness": 0.0, "friction": -0.1, "damping": math.nan}),
    ],
)
def test_numbers_are_checked(kind, wrong):
    for name, value in wrong.items():
        with pytest.raises(ValueError, match=f"{name} must be"):
            kind(**{name: value})
