"""Eq. (1): the dual against OSQP, SciPy, known answers, and what a degenerate set must keep."""

import sys
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, strategies as st

from surface_gym.physics.references import SOLVERS, Solver
from tests.physics.contact_sets import PITCH, SQUARE, WEIGHT, draw_arms, dual

EVERY_SOLVER: dict[str, Solver] = {
    "dual": lambda arms, _weight, load, stiffness: dual(arms, load, stiffness),
    **SOLVERS,
}
GRID = PITCH * np.array([(x, y) for y in (-1.0, 0.0, 1.0) for x in (-1.0, 0.0, 1.0)])


class ContactSet(NamedTuple):
    arms: np.ndarray  # (contacts, 2) [m]
    load: np.ndarray  # (2,) [m]


Sets, Forces = list[ContactSet], list[np.ndarray]


def draw_contact_set(rng: np.random.Generator) -> ContactSet:
    """Three to 25 elements of a 5 x 5 grid, and a load inside their hull."""
    while True:
        arms = draw_arms(rng, int(rng.integers(3, 26)))
        if np.linalg.matrix_rank(arms - arms.mean(axis=0), tol=1e-6) == 2:
            break
    towards = rng.dirichlet(np.ones(len(arms)))
    reach = rng.uniform(0.0, 0.999)
    focus = arms[rng.integers(len(arms))]
    return ContactSet(arms, reach * focus + (1.0 - reach) * towards @ arms)


@pytest.fixture(scope="module")
def contact_sets() -> list[ContactSet]:
    rng = np.random.default_rng(1)
    return [draw_contact_set(rng) for _ in range(1_000)]


@pytest.fixture(scope="module")
def dual_forces(contact_sets: Sets) -> list[np.ndarray]:
    """Of these, a third to two thirds have active bounds."""
    answers = [dual(arms, load) for arms, load in contact_sets]
    assert not any(degenerate for _, degenerate in answers)
    assert 1 / 3 < np.mean([(normal == 0.0).any() for normal, _ in answers]) < 2 / 3
    return [normal for normal, _ in answers]


@pytest.mark.parametrize("reference", SOLVERS)
def test_the_dual_agrees_with_the_references(
    contact_sets: Sets, dual_forces: Forces, reference: str
) -> None:
    rng = np.random.default_rng(2)
    for k, ((arms, load), normal) in enumerate(zip(contact_sets, dual_forces, strict=True)):
        stiffness = np.ones(len(arms))
        if k % 2:
            stiffness = rng.uniform(0.5, 2.0, size=len(arms))
            normal, _ = dual(arms, load, stiffness)
        expected, degenerate = SOLVERS[reference](arms, WEIGHT, load, stiffness)
        assert not degenerate
        np.testing.assert_allclose(normal, expected, rtol=0.0, atol=1e-6 * WEIGHT)


@pytest.mark.parametrize("solver", EVERY_SOLVER)
def test_a_stiffer_contact_bears_more(solver: str) -> None:
    stiffness = np.array([3.0, 1.0, 1.0, 3.0])
    normal, _ = EVERY_SOLVER[solver](SQUARE, WEIGHT, np.zeros(2), stiffness)
    np.testing.assert_allclose(normal / WEIGHT, stiffness / 8.0, rtol=0.0, atol=1e-6)


TRIANGLE = PITCH * np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (1.0, 1.0)])
BLUNT = PITCH * np.array([(0.0, 0.0), (1.0, 0.0), (-1.0, 1.0)])
TILTED = (2 + 1.5 * GRID[:, 0] / PITCH) / 18
# Each with a load [m] and the share of the weight that every contact bears.
KNOWN = {
    "centred: evenly": (GRID, (0.0, 0.0), np.full(9, 1 / 9)),
    "off centre: a plane": (GRID, (0.05, 0.0), TILTED),
    "between rows: a lever": (SQUARE, (0.0, 0.05), (0.125, 0.125, 0.375, 0.375)),
    "over a corner: that corner alone": (SQUARE[:3], (-0.1, -0.1), (1, 0, 0)),
    "over a side: that side alone": (SQUARE, (0.1, 0.0), (0, 0.5, 0, 0.5)),
    "over the corner of a triangle": (TRIANGLE, (0.0, 0.0), (1, 0, 0, 0)),
}
# Where the load is not within the contacts, the nearest bear it.
DEGENERATE = {
    "one contact": (SQUARE[:1], (0.0, 0.0), (1,)),
    "two contacts": (SQUARE[:2], (0.05, 0.3), (0.25, 0.75)),
    "collinear": (GRID[3:6], (0.05, 0.0), (1 / 12, 1 / 3, 7 / 12)),
    "collinear, load beyond": (GRID[[0, 4, 8]], (-0.3, -0.4), (1, 0, 0)),
    "load beyond a side": (SQUARE, (0.0, 0.15), (0, 0, 0.5, 0.5)),
    "load beyond a corner": (SQUARE, (0.3, 0.25), (0, 0, 0, 1)),
    "load beyond a blunt corner": (BLUNT, (-0.1, -0.01), (0.55, 0, 0.45)),
}


@pytest.mark.parametrize("solver", EVERY_SOLVER)
@pytest.mark.parametrize("name", [*KNOWN, *DEGENERATE])
def test_known_answers(solver: str, name: str) -> None:
    arms, load, share = {**KNOWN, **DEGENERATE}[name]
    normal, degenerate = EVERY_SOLVER[solver](arms, WEIGHT, np.array(load), np.ones(len(arms)))
    assert degenerate == (name in DEGENERATE)
    assert normal.sum() == pytest.approx(WEIGHT, rel=1e-9 if degenerate else 1e-5)
    tolerance = 1e-3 if degenerate else 1e-6
    np.testing.assert_allclose(normal / WEIGHT, share, rtol=0.0, atol=tolerance)


def distance_to_hull(arms: np.ndarray, load: np.ndarray) -> float:
    """[m] from a point to the convex hull of the arms:

    0 if they surround it, else to the nearest of all the lines that join two of them.
    """
    away = arms - load
    angles = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    if np.diff(angles, append=angles[0] + 2.0 * np.pi).max() < np.pi:
        return 0.0
    first, second = (away[k] for k in np.triu_indices(len(away)))
    along = second - first
    length = np.maximum(np.sum(along**2, axis=1), 1e-300)
    share = np.clip(-np.sum(first * along, axis=1) / length, 0.0, 1.0)
    return float(np.linalg.norm(first + share[:, np.newaxis] * along, axis=1).min())


@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 25),
    reach=st.floats(0.0, 0.6),
    direction=st.floats(-np.pi, np.pi),
    between=st.sampled_from([None, 0.0, 0.5, 0.3]),
)
def test_any_set_comes_as_near_to_the_load_as_it_can(
    seed: int, count: int, reach: float, direction: float, between: float | None
) -> None:
    arms = draw_arms(np.random.default_rng(seed), count)
    load = reach * np.array([np.cos(direction), np.sin(direction)])
    if between is not None:  # two contacts, or over one
        first, second = arms[np.random.default_rng(seed + 1).integers(count, size=2)]
        load = (1.0 - between) * first + between * second
    normal, degenerate = dual(arms, load)
    miss = float(np.linalg.norm(normal @ arms / WEIGHT - load))
    assert normal.min() >= 0.0
    assert normal.sum() == pytest.approx(WEIGHT, rel=1e-9)
    assert miss == pytest.approx(distance_to_hull(arms, load), abs=1e-3 * PITCH)
    assert miss < 1e-5 * PITCH or (degenerate and between is None)


def test_without_osqp_an_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(ImportError, match=r"pip install 'surface_gym\[validation\]'"):
        SOLVERS["osqp"](np.array(SQUARE), WEIGHT, np.zeros(2), None)
