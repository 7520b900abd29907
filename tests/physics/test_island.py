"""Impulses between sides, against other solvers and what is known by hand."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.optimize import nnls

import surface_gym as sg
from surface_gym.compiler.jit import compiled
from surface_gym.parcel import make_bodies
from surface_gym.physics import island
from surface_gym.physics.collision import make_world_scratch
from surface_gym.physics.island import Island
from surface_gym.physics.types import Array
from tests.worlds import G, Meeting, ice, supports


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 6))
def test_discs_in_a_heap_get_the_least_change_that_parts_them(seed: int, count: int) -> None:
    """Gauss's principle, solved as least squares over the impulses."""
    rng = np.random.default_rng(seed)
    radius = 0.1
    # A triangular heap: each disc touches up to six others.
    spots = np.array([[0, 0], [2, 0], [1, 3**0.5], [3, 3**0.5], [4, 0], [2, 2 * 3**0.5]])
    spots = 1.0 + radius * spots[:count]
    masses = np.exp(rng.uniform(-2.0, 2.0, count))
    velocities = rng.uniform(-1.0, 1.0, (count, 2))
    normals = {
        (i, j): (spots[j] - spots[i]) / (2.0 * radius)
        for i, j in itertools.combinations(range(count), 2)
        if np.linalg.norm(spots[i] - spots[j]) < 2.0 * radius + 1e-9
    }
    closing = np.zeros((len(normals), count, 2))
    for row, ((i, j), normal) in enumerate(normals.items()):
        closing[row, i], closing[row, j] = -normal, normal
    closing = closing.reshape(-1, 2 * count)
    per_mass = np.repeat(1.0 / masses, 2)
    moved = closing * np.sqrt(per_mass)
    # min |root(1/M) J' P + root(M) v|^2 over P >= 0
    impulses, _ = nnls(moved.T, -velocities.ravel() / np.sqrt(per_mass))
    expected = velocities.ravel() + per_mass * (closing.T @ impulses)

    meeting = Meeting(
        ice(),
        [sg.Parcel(sg.Disc(radius), mass=mass) for mass in masses],
        [(*spot, 0.0) for spot in spots],
        [(*velocity, 0.0) for velocity in velocities],
        side_friction=0.0,
    )
    meeting.step(1e-6)
    np.testing.assert_allclose(meeting.velocity[:, :2].ravel(), expected, atol=2e-6)


def oblique(friction: float, restitution: float, speed: Array) -> Array:
    """(2, 3) velocities after a disc with a speed (2,) has hit its like, to the right of it."""
    meeting = Meeting(
        ice(),
        [sg.Parcel(sg.Disc(0.1), mass=2.0)] * 2,
        [(1.0, 1.0, 0.0), (1.2, 1.0, 0.5)],
        [(*speed, 0.0), (0.0, 0.0, 0.0)],
        side_friction=friction,
        restitution=restitution,
    )
    meeting.step(1e-3)
    return meeting.velocity


@pytest.mark.parametrize("restitution", [0.0, 0.4, 1.0])
@pytest.mark.parametrize(("friction", "slides"), [(0.05, True), (0.9, False)])
def test_an_oblique_impact_is_the_textbooks(
    friction: float, slides: bool, restitution: float
) -> None:
    """Poisson's normal impulse is (1 + e) m u / 2; along the side mu times it acts, or what stops
    the sides, m w / 6 for discs (J = m r^2 / 2).
    """
    u, w = 1.0, 0.5
    normal = (1.0 + restitution) * u / 2.0
    side = friction * normal if slides else w / 6.0
    spin = -2.0 * side / 0.1  # r P / (r^2 / 2), of both the same
    expected = [[u - normal, w - side, spin], [normal, side, spin]]
    np.testing.assert_allclose(
        oblique(friction, restitution, np.array([u, w])), expected, atol=1e-7
    )


def test_a_parcel_that_nothing_holds_leans_with_all_its_weight_on_one_that_is_held() -> None:
    tilt, dt = math.radians(10.0), 0.005
    rotor = np.tile(np.arange(40) >= 20, (20, 1))  # with axes along the slope: they hold
    surface = sg.Surface(np.zeros((20, 40)), rotor, mu_support=0.0, tilt=tilt)
    parcel = sg.Parcel(sg.Rectangle(0.4, 0.4), mass=3.0, com_height=0.0)
    meeting = Meeting(surface, [parcel] * 2, [(1.8, 1.0, 0.0), (2.2, 1.0, 0.0)], side_friction=0.3)
    for _ in range(20):
        touches = meeting.step(dt)
    force = parcel.mass * G * math.sin(tilt)
    assert touches == [(0, 1, pytest.approx(force * dt, rel=1e-3))]
    assert np.abs(meeting.velocity).max() < 1e-5


@pytest.mark.parametrize("light", [1e-3, 1e-1, 1.0])
def test_however_light_the_one_that_is_held_the_other_does_not_press_on(light: float) -> None:
    who = [sg.Parcel(sg.Rectangle(0.4, 0.4), mass, com_height=0.0) for mass in (10.0, light)]
    meeting = Meeting(
        supports(0.2), who, [(1.8, 1.0, 0.0), (2.2, 1.0, 0.0)], [(1.0, 0, 0), (0, 0, 0)]
    )
    meeting.step(1e-4)
    common = 10.0 / (10.0 + light)
    np.testing.assert_allclose(meeting.velocity[:, 0], common - 0.2 * G * 1e-4, atol=1e-8)


def test_blocks_of_one_friction_slide_on_together_as_one_would() -> None:
    parcel = sg.Parcel(sg.Rectangle(0.25, 0.4), com_height=0.0)
    poses = [(1.0 + 0.25 * k, 1.0, 0.0) for k in range(8)]
    meeting = Meeting(supports(0.1), [parcel] * 8, poses, [(1.0, 0.0, 0.0)] * 8)
    for _ in range(100):
        meeting.step(0.005)
    np.testing.assert_allclose(meeting.velocity, [(1.0 - 0.1 * G * 0.5, 0.0, 0.0)] * 8, atol=1e-7)


clear_matrix = compiled(island.clear_matrix.py_func)
solve = compiled(island.solve_direction.py_func)
PARCELS = 7


def group_of(touching: list[tuple[int, int]], member: list[int]) -> Island:
    """Some of seven parcels, which touch at a point each two; its matrix is full of old numbers."""
    scratch = make_world_scratch(PARCELS)
    own = {
        "members": len(member), "contacts": len(touching), "body": np.arange(PARCELS),
        "bodies": make_bodies([sg.layouts.box("S")] * PARCELS),
    }  # fmt: skip
    shared = {name: getattr(scratch, name) for name in set(Island._fields) - set(own)}
    group = Island(**own, **shared)
    group.member[: len(member)] = member
    group.slot[member] = np.arange(len(member))
    group.contact[: len(touching)] = np.arange(len(touching))
    group.ends[: len(touching), :2] = np.reshape(touching, (-1, 2))
    group.matrix.fill(np.nan)
    return group


@pytest.mark.parametrize(
    "touching",
    [
        [],
        [(0, 1)],
        [(2, 0), (1, 3), (3, 4)],  # two apart, in a row that is not theirs
        [(0, 4), (4, 1), (1, 3), (3, 2)],  # a chain
        [(0, 1), (0, 2), (0, 3), (0, 4)],  # all about one
        [(i, j) for i in range(5) for j in range(i)],
    ],
)
@pytest.mark.parametrize("member", [[0, 1, 2, 3, 4], [6, 4, 3, 1, 0]])
def test_it_solves_what_they_share(touching: list[tuple[int, int]], member: list[int]) -> None:
    rng = np.random.default_rng(len(touching))
    size = 3 * len(member)
    # What each adds by itself, and what two who touch add: all of it positive definite.
    matrix = np.zeros((size, size))
    for part in [(k,) for k in range(len(member))] + touching:
        rows = np.concatenate([3 * k + np.arange(3) for k in part])
        root = rng.normal(size=(len(rows), len(rows)))
        matrix[np.ix_(rows, rows)] += root @ root.T + 0.1 * np.eye(len(rows))
    group = group_of([(member[i], member[j]) for i, j in touching], member)
    clear_matrix(group)
    kept = np.tril(~np.isnan(group.matrix[:size, :size]))
    assert (kept | (np.tril(matrix) == 0.0)).all()
    group.matrix[:size, :size][kept] = matrix[kept]
    group.gradient[member] = rng.normal(size=(len(member), 3))
    solve(group)
    expected = np.linalg.solve(matrix, -group.gradient[member].ravel())
    np.testing.assert_allclose(group.direction[member].ravel(), expected, rtol=1e-9, atol=1e-12)
