"""The implicit step against another convex solver, its own optimality, and known answers."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from surface_gym.physics.friction import ROUNDING
from surface_gym.physics.references import implicit_velocity
from surface_gym.physics.types import Grid
from tests.physics import contact_sets as sets

GYRATION, DT = 0.01, 0.005  # [m^2], [s]
Pair, Triple = tuple[float, float], tuple[float, float, float]


@dataclass(frozen=True)
class Problem:
    """One step: its contacts, by default a square's, and where it starts."""

    velocity: np.ndarray  # (3,) [m/s, m/s, rad/s]
    axis: np.ndarray  # (contacts,) [rad]
    rotor: np.ndarray  # (contacts,) bool
    normal: np.ndarray  # (contacts,) [m/s^2]
    arms: np.ndarray = field(default_factory=lambda: sets.SQUARE)  # (contacts, 2) [m]
    grid: Grid = field(default_factory=sets.make_grid)
    gyration: float = GYRATION  # [m^2] inertia / mass
    dt: float = DT  # [s]
    friction: sets.Friction = sets.TABLE_1

    @property
    def inertia(self) -> np.ndarray:
        return np.array([1.0, 1.0, self.gyration])

    @property
    def free_velocity(self) -> np.ndarray:
        """Velocity after the step without friction."""
        return self.velocity + self.dt * np.array([self.grid.gravity_x, self.grid.gravity_y, 0.0])

    @property
    def slides(self) -> tuple[np.ndarray, np.ndarray]:
        """(contacts, 3) each: rows whose product with a velocity is the slide along and across."""
        ax, ay = np.cos(self.axis), np.sin(self.axis)
        x, y = self.arms.T
        return (
            np.column_stack([ax, ay, x * ay - y * ax]),
            np.column_stack([-ay, ax, x * ax + y * ay]),
        )

    def step(self) -> np.ndarray:
        scratch, contacts = sets.make_contacts(
            self.arms, self.axis, self.rotor, self.normal, friction=self.friction
        )
        velocity = implicit_velocity(
            self.grid, self.gyration, scratch, contacts, self.dt, *self.velocity
        )
        return np.array(velocity)


def over_square(rotors: bool, velocity: Triple, axis: float = 0.0, **changes: Any) -> Problem:
    """Four rotors or supports that bear equal loads."""
    contacts = (np.full(4, axis), np.full(4, rotors), np.full(4, sets.WEIGHT / 4))
    return Problem(np.array(velocity), *contacts, **changes)


def draw_problem(rng: np.random.Generator, rotors: float) -> Problem:
    """Contacts of a 5 x 5 grid, a share of them rotors; speeds from creeping to fast."""
    count = int(rng.integers(1, 26))
    return Problem(
        grid=sets.make_grid(*rng.choice([0.0, 1.0, -2.0], size=2).tolist()),
        gyration=float(rng.uniform(0.002, 0.05)),
        dt=float(rng.choice([1e-4, 1e-3, 5e-3, 1e-2, 0.1])),
        velocity=rng.normal(size=3) * rng.choice([0.0, 1e-5, 1e-2, 1.0, 3.0]),
        arms=sets.draw_arms(rng, count),
        axis=rng.choice([0.0, 0.5, 1.0, -0.5], size=count) * np.pi / 2.0,
        rotor=rng.random(count) < rotors,
        normal=sets.WEIGHT * rng.dirichlet(np.ones(count)) * (rng.random(count) < 0.9),
    )


def dual_minimiser(problem: Problem) -> np.ndarray:
    """The step over rotors by a bounded least-squares solver.

    A rounded |u| is the largest of f u - f^2 ROUNDING / (2 F) over |f| <= F, the friction force;
    so the step is a least-squares problem in the forces, one for each contact along and across.
    """
    along, across = problem.slides
    load = problem.dt * problem.normal[problem.normal > 0.0]
    rows = np.concatenate([along[problem.normal > 0.0], across[problem.normal > 0.0]])
    most = np.concatenate([problem.friction.along * load, problem.friction.across * load])
    root = np.sqrt(problem.inertia)
    # In units of each force's bound, for the solver's conditioning.
    system = np.vstack([(most[:, np.newaxis] * rows / root).T, np.diag(np.sqrt(ROUNDING * most))])
    target = np.concatenate([root * problem.free_velocity, np.zeros(len(most))])
    forces = lsq_linear(system, target, bounds=(-1.0, 1.0), method="bvls", tol=1e-14).x
    return problem.free_velocity - rows.T @ (most * forces) / problem.inertia


def gradient(problem: Problem, velocity: np.ndarray) -> np.ndarray:
    """(3,) of what the step minimises, written over arrays."""
    along, across = problem.slides
    u, v = along @ velocity, across @ velocity
    speed = np.maximum(np.hypot(u, v), ROUNDING)
    mu = problem.friction
    force_along, force_across = (
        np.where(problem.rotor, most * np.clip(w / ROUNDING, -1, 1), mu.support * w / speed)
        for most, w in ((mu.along, u), (mu.across, v))
    )
    load = problem.dt * problem.normal
    inertial = problem.inertia * (velocity - problem.free_velocity)
    return inertial + along.T @ (load * force_along) + across.T @ (load * force_across)


@pytest.mark.parametrize("seed", range(10))
def test_over_rotors_the_step_agrees_with_a_least_squares_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(20):
        problem = draw_problem(rng, rotors=1.0)
        if not problem.normal.any():
            continue
        np.testing.assert_allclose(problem.step(), dual_minimiser(problem), rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("rotors", [0.0, 0.5, 0.9, 1.0])
def test_the_step_satisfies_the_optimality_condition(rotors: float) -> None:
    """What is minimised is strongly convex: a velocity is no farther from the minimum, in the
    norm of the inertia, than its gradient is from zero.
    """
    rng = np.random.default_rng(7)
    for _ in range(500):
        problem = draw_problem(rng, rotors)
        left = gradient(problem, problem.step()) / np.sqrt(problem.inertia)
        assert np.linalg.norm(left) < 1e-8  # [m/s]


@pytest.mark.parametrize(
    ("axis", "velocity", "deceleration"),
    [
        pytest.param(0.0, (1.0, 0.0), (0.5, 0.0), id="along the axis"),
        pytest.param(np.pi / 2, (1.0, 0.0), (0.01, 0.0), id="across the axis"),
        pytest.param(0.0, (1.0, -1.0), (0.5, -0.01), id="both"),
        pytest.param(np.pi, (1.0, -1.0), (0.5, -0.01), id="an axis has no sense"),
        pytest.param(np.pi / 4, (1.0, 0.0), (0.51 / 2**0.5, 0.49 / 2**0.5), id="the axis turns it"),
    ],
)
def test_sliding_is_slowed_by_coulomb_friction(
    axis: float, velocity: Pair, deceleration: Pair
) -> None:
    expected = np.array(velocity) - DT * sets.WEIGHT * np.array(deceleration)
    after = over_square(True, (*velocity, 0.0), axis).step()
    np.testing.assert_allclose(after, [*expected, 0.0], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("velocity", "left"),
    [
        ((0.6, 0.8, 0.0), 1.0 - DT * 0.1 * sets.WEIGHT),
        # About its centre, at a radius of sqrt(0.02) m.
        ((0.0, 0.0, 3.0), 1.0 - DT * 0.1 * sets.WEIGHT * 0.02**0.5 / GYRATION / 3.0),
    ],
)
def test_supports_slow_in_the_direction_of_motion(velocity: Triple, left: float) -> None:
    after = over_square(False, velocity, friction=sets.Friction(support=0.1)).step()
    np.testing.assert_allclose(after, left * np.array(velocity), rtol=0.0, atol=1e-9)


def test_isotropic_contacts_alone_or_beside_an_unloaded_rotor_are_the_same_to_the_bit() -> None:
    """Both loops over isotropic contacts, over all of them and by a list, follow one law."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        alone = draw_problem(rng, rotors=0.0)
        beside = replace(
            alone,
            arms=np.append(alone.arms, [[0.1, 0.2]], axis=0),
            axis=np.append(alone.axis, 0.3),
            rotor=np.append(alone.rotor, True),
            normal=np.append(alone.normal, 0.0),
        )
        np.testing.assert_array_equal(alone.step(), beside.step())


@pytest.mark.parametrize("pull", [0.0, 0.4 * sets.WEIGHT, -0.4 * sets.WEIGHT])
@pytest.mark.parametrize("axis", [0.0, 0.5 * np.pi])
def test_friction_holds_a_parcel_on_a_slope(axis: float, pull: float) -> None:
    way = np.array([axis == 0.0, axis != 0.0], dtype=float)
    grid = sets.make_grid(*(pull * way))
    after = over_square(True, (0.0, 0.0, 0.0), axis, grid=grid).step()
    # The rounded friction lets it creep: v + dt mu N v / ROUNDING = dt g sin(gamma).
    creep = DT * pull / (1.0 + DT * 0.5 * sets.WEIGHT / ROUNDING)
    assert abs(creep) < ROUNDING
    np.testing.assert_allclose(after, [*(creep * way), 0.0], rtol=0.0, atol=1e-12)
