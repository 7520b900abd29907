"""Forces of a step are what changes the motion: Newton's law for every parcel, and its torque."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.compiler.jit import compiled
from surface_gym.physics import types as ph
from surface_gym.physics.contact_solver import step_world
from surface_gym.physics.world_forces import make_world_forces, observe_world
from tests.worlds import Meeting, supports

DT = 1e-3
step_alone = compiled(step_world.py_func)


def turned_surface() -> sg.Surface:
    """Rotors whose axes differ, and every third element a support, on a slope."""
    generator = np.random.default_rng(3)
    axis = generator.uniform(-np.pi, np.pi, (30, 40))
    return sg.Surface(axis, generator.random((30, 40)) < 0.7, tilt=0.1, tilt_direction=0.7)


def crowd(surface: sg.Surface, restitution: float) -> Meeting:
    """Nine parcels in a block, pressed together by those at its ends, and one that is alone."""
    generator = np.random.default_rng(5)
    parcels, poses, velocities = [], [], []
    for k in range(9):
        parcels.append(sg.Parcel(sg.Rectangle(0.3, 0.3), mass=generator.uniform(1.0, 9.0)))
        row, column = divmod(k, 3)
        poses.append([1.0 + 0.301 * column, 0.8 + 0.301 * row, 0.0])
        velocities.append([0.6 * (1 - column), 0.6 * (1 - row), 0.2 * (k % 2)])
    parcels.append(sg.Parcel(sg.Disc(0.2), mass=3.0))
    return Meeting(
        surface, parcels, [*poses, [3.2, 2.4, 0.0]], [*velocities, [1.0, 0.0, 2.0]], restitution
    )


def observe(meeting: Meeting):
    """Step once: the forces, their number of pushes, and the states before and after."""
    forces = make_world_forces(len(meeting.masses))
    before = meeting.world.state.copy()
    pushed = observe_world(
        meeting.grid, meeting.world, meeting.touching, meeting.scratch, DT, forces
    )
    return forces, pushed, before, meeting.world.state


def sum_on(forces, pushed: int, k: int, gravity: np.ndarray) -> np.ndarray:
    """The force [N] on a parcel."""
    total = gravity + forces.below[forces.first[k] : forces.first[k + 1], 1:].sum(axis=0)
    for (first, second), push in zip(forces.pair[:pushed], forces.push[:pushed], strict=True):
        total = total + push[2:] * (int(second == k) - int(first == k))
    return total


@pytest.mark.parametrize(("restitution", "least"), [(0.0, 100), (0.6, 10)])
@pytest.mark.parametrize("surface", [turned_surface(), supports(0.4, 0.05)])
def test_they_change_the_motion(surface, restitution, least):
    meeting = crowd(surface, restitution)
    grid, pushes = meeting.grid, 0
    for _ in range(40):
        forces, pushed, before, after = observe(meeting)
        pushes += pushed
        for k, mass in enumerate(meeting.masses):
            gained = mass * (after[k, ph.VX : ph.VY + 1] - before[k, ph.VX : ph.VY + 1]) / DT
            gravity = mass * np.array([grid.gravity_x, grid.gravity_y])
            assert sum_on(forces, pushed, k, gravity) == pytest.approx(gained, abs=1e-3)
    assert pushes > least


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_they_turn_a_parcel(restitution):
    meeting = crowd(turned_surface(), restitution)
    grid = meeting.grid
    for _ in range(40):
        forces, pushed, before, after = observe(meeting)
        for k, inertia in enumerate(meeting.inertias):
            middle = 0.5 * (before[k, :2] + after[k, :2])
            row, column = forces.element[forces.first[k] : forces.first[k + 1]].T
            x = grid.x0 + grid.pitch_x * column - middle[0]
            y = grid.y0 + grid.pitch_y * row - middle[1]
            _, fx, fy = forces.below[forces.first[k] : forces.first[k + 1]].T
            torque = float((x * fy - y * fx).sum())
            for pair, push in zip(forces.pair[:pushed], forces.push[:pushed], strict=True):
                sign = int(pair[1] == k) - int(pair[0] == k)
                arm = push[:2] - middle
                torque += sign * (arm[0] * push[3] - arm[1] * push[2])
            gained = inertia * (after[k, ph.OMEGA] - before[k, ph.OMEGA]) / DT
            # Places are those of the step's middle, forces those of its end.
            assert torque == pytest.approx(gained, abs=0.02 * max(1.0, abs(gained)))


def test_a_blow_is_a_force_too():
    """Without friction between sides the whole blow lies along the normal."""
    boxes = [sg.Parcel(sg.Rectangle(0.3, 0.3), mass=m) for m in (2.0, 5.0)]
    meeting = Meeting(
        supports(0.2), boxes, [[1.0, 1.0, 0.0], [1.3003, 1.1, 0.0]], [[1.0, 0, 0], [0, 0, 0]],
        restitution=0.6, side_friction=0.0,
    )  # fmt: skip
    forces, pushed, before, after = observe(meeting)
    assert pushed == 1
    for k, mass in enumerate(meeting.masses):
        gained = mass * (after[k, ph.VX : ph.VY + 1] - before[k, ph.VX : ph.VY + 1]) / DT
        assert sum_on(forces, pushed, k, np.zeros(2)) == pytest.approx(gained, rel=1e-6, abs=1e-3)
    assert forces.push[0, 2] > 1000.0
    # The sides stay parallel, so both boxes turn alike: the arms are as the masses.
    assert forces.push[0, :2] == pytest.approx([1.15, 1.0 + 0.1 * 2.0 / 7.0], abs=1e-3)


def test_weight_is_carried():
    meeting = crowd(turned_surface(), 0.0)
    forces, _, _, _ = observe(meeting)
    for k, mass in enumerate(meeting.masses):
        carried = forces.below[forces.first[k] : forces.first[k + 1], 0].sum()
        assert carried == pytest.approx(mass * meeting.grid.gravity_normal, rel=1e-9)


def test_the_step_is_step_worlds_to_the_bit():
    watched, alone = crowd(turned_surface(), 0.3), crowd(turned_surface(), 0.3)
    for _ in range(60):
        observe(watched)
        step_alone(alone.grid, alone.world, alone.touching, alone.scratch, DT)
        assert watched.world.state.tobytes() == alone.world.state.tobytes()
