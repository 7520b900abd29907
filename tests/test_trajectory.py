"""What a run tells: its contacts against Newton's laws and geometry, and where the energy goes."""

import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given

import surface_gym as sg
from surface_gym.physics.friction import TOLERANCE
from surface_gym.physics.step import RESTART_SPEED
from surface_gym.trajectory import Trajectory, repeat
from tests.environments import outside
from tests.strategies import scenes

G = 9.81  # [m/s^2]
BOX = sg.layouts.box("S")
SUPPORTS = sg.Surface(np.zeros((10, 10)), np.zeros((10, 10), dtype=bool))
TRIANGLE = sg.Parcel(
    sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.0, 0.3)]), mass=3.0, com_offset=(0.02, -0.01)
)
every_method = pytest.mark.parametrize("method", ["implicit", "explicit"])


def sorted_on_a_slope(**changes: object) -> Trajectory:
    """An off-centre triangle that slides and spins down a sorting line."""
    surface = sg.layouts.sorting(tilt=math.radians(5.0))
    start = {"pose": (0.5, 1.0, 0.3), "velocity": (1.2, 0.1, -0.5), "duration": 0.503, **changes}
    return sg.simulate(surface, TRIANGLE, **start)


def downhill(surface: sg.Surface) -> np.ndarray:
    """(2,) [m/s^2] of gravity along the surface."""
    direction = np.array([math.cos(surface.tilt_direction), math.sin(surface.tilt_direction)])
    return G * math.sin(surface.tilt) * direction


def sums_of_steps(run: Trajectory, values: np.ndarray) -> np.ndarray:
    """(T, ...) of values (rows, ...) of the contacts."""
    sums = np.zeros((len(run.time), *values.shape[1:]))
    np.add.at(sums, run.contacts.step, values)
    return sums


def arms(run: Trajectory) -> np.ndarray:
    """(rows, 2) [m] from the centre of mass, where it was as the contacts were found."""
    length = np.diff(run.time)[run.contacts.step - 1]
    lead = (0.5 if run.run.method == "implicit" else 0.0) * length
    before = run.run.states[run.contacts.step - 1]
    return run.contacts.place - before[:, :2] - lead[:, None] * before[:, 3:5]


def assert_newton_holds(run: Trajectory, forces: float) -> None:
    """Forces and torques are mass and inertia times acceleration, to forces [N] / mass."""
    parcel, surface = run.run.parcel, run.run.surface
    contacts, arm = run.contacts, arms(run)
    gravity = downhill(surface)
    total = sums_of_steps(run, contacts.force) / parcel.mass + gravity
    np.testing.assert_allclose(run.acceleration[1:, :2], total[1:], rtol=0.0, atol=forces)
    twist = arm[:, 0] * contacts.force[:, 1] - arm[:, 1] * contacts.force[:, 0]
    spin = sums_of_steps(run, twist) / parcel.moment_of_inertia
    gyration = math.sqrt(parcel.moment_of_inertia / parcel.mass)
    np.testing.assert_allclose(run.acceleration[1:, 2], spin[1:], rtol=0.0, atol=forces / gyration)


def assert_repeats(run: Trajectory) -> None:
    """The run's steps, repeated, lead where it went, to the bit."""
    _, observed = repeat(run.run, run.time)
    assert observed.state.tobytes() == run.run.states.tobytes()


class TestRepeatedSteps:
    @every_method
    @pytest.mark.parametrize("solver", ["dual", "osqp", "scipy"])
    def test_they_lead_where_the_run_went_by_its_forces(self, method, solver):
        run = sorted_on_a_slope(method=method, normal_forces=solver)
        assert run.time[-1] == 0.503  # the last step is shorter
        assert_repeats(run)
        assert_newton_holds(run, 1e-7 if method == "implicit" else 1e-12)

    @given(scene=scenes())
    def test_whatever_the_scene(self, scene):
        """Newton's law holds to what the step's solver leaves of its optimality condition."""
        run = scene.run(duration=0.2)
        assert_repeats(run)
        left = TOLERANCE * max(1.0, math.sqrt(run.run.parcel.body.gyration)) / 0.005
        assert_newton_holds(run, left)

    def test_where_a_run_ends_early(self):
        run = sg.simulate(SUPPORTS, BOX, (0.5, 0.5, 0.1), (2.0, 0.0, 0.0), duration=2.0013)
        assert run.end == "left the surface"
        assert_repeats(run)

    def test_nothing_is_found_out_before_it_is_asked_for(self):
        run = sorted_on_a_slope()
        assert not {"contacts", "acceleration", "energy"} & set(vars(run))
        assert run.contacts is run.contacts


class TestForces:
    @every_method
    def test_the_acceleration_is_that_of_the_motion(self, method):
        run = sorted_on_a_slope(method=method)
        np.testing.assert_array_equal(run.acceleration[0], 0.0)
        motion = np.diff(run.run.states[:, 3:6], axis=0) / np.diff(run.time)[:, None]
        np.testing.assert_allclose(run.acceleration[1:], motion, rtol=0.0, atol=1e-9)

    @pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
    @given(scene=scenes())
    def test_normal_forces_carry_the_weight_and_bound_the_friction(self, scene):
        run = scene.run(duration=0.2)
        parcel = scene.parcel
        weight = parcel.mass * G * math.cos(scene.surface.tilt)
        assert (run.contacts.normal >= 0.0).all()
        total = sums_of_steps(run, run.contacts.normal)[1:]
        np.testing.assert_allclose(total, weight, rtol=1e-9)
        # Their moments hold the centre of mass upright, but where the parcel tips.
        moment = sums_of_steps(run, run.contacts.normal[:, None] * arms(run))[1:]
        pull = downhill(scene.surface) - run.acceleration[:-1, :2]
        upright = ~run.tipping[1:]
        expected = parcel.mass * parcel.com_height * pull
        np.testing.assert_allclose(moment[upright], expected[upright], atol=1e-6 * weight)
        # Friction is within its limits and against the slip, and no energy is lost.
        contacts, surface = run.contacts, scene.surface
        rotor, normal = contacts.rotor, contacts.normal * (1.0 + 1e-12) + 1e-12
        assert (np.abs(contacts.along[rotor]) <= surface.mu_max * normal[rotor]).all()
        assert (np.abs(contacts.across[rotor]) <= surface.mu_min * normal[rotor]).all()
        support = np.hypot(*contacts.force[~rotor].T)
        assert (support <= surface.mu_support * normal[~rotor]).all()
        assert (contacts.along * contacts.slip[:, 0] <= 1e-12).all()
        assert (contacts.across * contacts.slip[:, 1] <= 1e-12).all()
        np.testing.assert_allclose(run.energy.balance, 0.0, atol=1e-7 * parcel.mass)

    def test_a_rotor_that_slips_along_its_axis_gives_all_it_can(self):
        run = sorted_on_a_slope()
        contacts = run.contacts
        slips = contacts.rotor & (np.abs(contacts.slip[:, 0]) > 1e-4)
        assert slips.sum() > 100
        expected = -0.5 * contacts.normal[slips] * np.sign(contacts.slip[slips, 0])
        np.testing.assert_allclose(contacts.along[slips], expected, rtol=1e-12)

    def test_along_and_across_are_the_axiss_and_a_supports_x_and_y(self):
        run = sorted_on_a_slope()
        contacts, surface = run.contacts, run.run.surface
        assert contacts.rotor.any()
        assert not contacts.rotor.all()
        axis = np.where(contacts.rotor, surface.axis[tuple(contacts.element.T)], 0.0)
        along = np.column_stack([np.cos(axis), np.sin(axis)])
        across = np.column_stack([-np.sin(axis), np.cos(axis)])
        force = contacts.along[:, None] * along + contacts.across[:, None] * across
        np.testing.assert_allclose(force, contacts.force, rtol=0.0, atol=1e-12)
        # The slip is that of a rigid body.
        vx, vy, omega = run.run.states[contacts.step, 3:6].T
        arm = arms(run)
        slip = np.column_stack([vx - omega * arm[:, 1], vy + omega * arm[:, 0]])
        turned = contacts.slip[:, :1] * along + contacts.slip[:, 1:] * across
        np.testing.assert_allclose(turned, slip, rtol=0.0, atol=1e-12)


class TestExplicitForces:
    def test_they_are_those_of_eq_2_at_the_velocity_before_the_step(self):
        run = sorted_on_a_slope(method="explicit")
        assert (run.velocity[:, 0] > 0.0).all()
        contacts, surface = run.contacts, run.run.surface
        vx, vy, omega = run.run.states[contacts.step - 1, 3:6].T
        arm = arms(run)
        ux, uy = vx - omega * arm[:, 1], vy + omega * arm[:, 0]
        axis = np.where(contacts.rotor, surface.axis[tuple(contacts.element.T)], 0.0)
        load = contacts.normal * np.tanh(5000.0 * np.hypot(ux, uy))
        alpha = axis - np.arctan2(uy, ux)
        along = np.where(contacts.rotor, 0.5 * np.sign(np.cos(alpha)), 0.005 * np.cos(alpha))
        across = np.where(contacts.rotor, -0.01 * np.sign(np.sin(alpha)), -0.005 * np.sin(alpha))
        np.testing.assert_allclose(contacts.along, -load * along, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(contacts.across, -load * across, rtol=0.0, atol=1e-9)

    def test_where_the_papers_rule_holds_the_parcel_friction_bears_gravity_alone(self):
        surface = sg.layouts.slowing(angle=0.0, task_columns=30, tilt=math.radians(5.0))
        run = sg.simulate(surface, BOX, (1.0, 1.0, 0.0), method="explicit")
        held = np.flatnonzero((run.velocity[:-1, 0] <= 0.0) & (run.velocity[1:, 0] == 0.0)) + 1
        assert len(held) >= 3
        contacts = run.contacts
        gravity = BOX.mass * G * math.sin(surface.tilt)
        total = sums_of_steps(run, contacts.force)
        np.testing.assert_allclose(total[held, 0], -gravity, rtol=1e-9)
        rotor = contacts.rotor
        assert (np.abs(contacts.along[rotor]) <= 0.5 * contacts.normal[rotor] + 1e-12).all()
        # Without the rule they hold far more.
        slipping = 0.5 * BOX.mass * G * math.tanh(5000.0 * RESTART_SPEED)
        assert slipping > 2.0 * gravity

    def test_where_supports_alone_would_hold_it_nothing_along_the_axes_acts(self):
        supports = sg.Surface(np.zeros((20, 30)), np.zeros((20, 30), dtype=bool), tilt=1e-3)
        run = sg.simulate(supports, BOX, (1.0, 1.0, 0.0), duration=0.1, method="explicit")
        np.testing.assert_allclose(run.acceleration, 0.0, atol=1e-15)
        total = sums_of_steps(run, run.contacts.force)[1:, 0]
        slipping = 0.005 * BOX.mass * G * math.cos(1e-3) * math.tanh(5000.0 * RESTART_SPEED)
        np.testing.assert_allclose(total, -slipping, rtol=1e-9)


class TestContacts:
    @every_method
    def test_they_are_the_elements_under_the_base(self, method):
        run = sorted_on_a_slope(method=method)
        surface, lead = run.run.surface, 0.5 if method == "implicit" else 0.0
        x, y = np.meshgrid(surface.x, surface.y)
        for k in range(1, len(run.time), 10):
            states = run.run.states[k - 1]
            place = states[:3] + lead * (run.time[k] - run.time[k - 1]) * states[3:6]
            under = outside(TRIANGLE.base, place, x, y, TRIANGLE.centre_of_mass) <= 1e-9
            contacts = run.contacts.of_step(k)
            np.testing.assert_array_equal(contacts.element, np.argwhere(under))
            np.testing.assert_array_equal(contacts.rotor, surface.rotor[under])
            np.testing.assert_array_equal(contacts.time, run.time[k])
            expected = np.column_stack([x[under], y[under]])
            np.testing.assert_array_equal(contacts.place, expected)

    def test_the_steps_together_are_the_record(self):
        contacts = sorted_on_a_slope(duration=0.05).contacts
        steps = [contacts.of_step(k) for k in range(1, int(contacts.step[-1]) + 1)]
        assert sum(map(len, steps)) == len(contacts)
        for field in fields(contacts):
            joined = np.concatenate([getattr(step, field.name) for step in steps])
            np.testing.assert_array_equal(joined, getattr(contacts, field.name))

    def test_a_trajectory_of_one_row_has_none(self):
        run = sg.simulate(sg.layouts.sorting(), BOX, (1.0, 1.0, 0.0), method="explicit")
        assert len(run.time) == 1
        assert len(run.contacts) == 0
        np.testing.assert_array_equal(run.acceleration, np.zeros((1, 3)))
        np.testing.assert_array_equal(run.energy.balance, [0.0])
        with pytest.raises(ValueError, match=r"^step must be in the record, got 1"):
            run.contacts.of_step(1)

    def test_a_step_that_is_none_is_refused(self):
        contacts = sorted_on_a_slope().contacts
        for step, allowed in ((0, "a whole number of at least 1"), (102, "between 1 and 101")):
            with pytest.raises(ValueError, match=f"^step must be {allowed}, got {step}"):
                contacts.of_step(step)


class TestEnergy:
    def test_what_the_explicit_step_leaves_goes_to_zero_with_it(self):
        left = [
            np.abs(sorted_on_a_slope(method="explicit", dt=dt).energy.balance).max()
            for dt in (4e-3, 1e-3, 2.5e-4, 6.25e-5)
        ]
        ratios = np.array(left[:-1]) / np.array(left[1:])
        np.testing.assert_allclose(ratios, 4.0, rtol=0.1)
        assert left[-1] < 1e-4

    @pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
    @pytest.mark.parametrize(("axis", "mu"), [(0.0, 0.5), (math.pi / 2, 0.01), (None, 0.005)])
    @every_method
    def test_it_is_friction_times_the_way(self, method, axis, mu):
        rotor = np.full((20, 30), axis is not None)
        surface = sg.Surface(np.full((20, 30), axis or 0.0), rotor)
        run = sg.simulate(surface, BOX, (1.0, 1.0, 0.0), (1.0, 0.0, 0.0), 0.15, 1e-4, method)
        energy, way = run.energy, run.pose[:, 0] - 1.0
        expected = mu * BOX.mass * G * way
        by = {0.5: energy.along, 0.01: energy.across, 0.005: energy.supports}
        np.testing.assert_allclose(by.pop(mu), expected, rtol=0.0, atol=1e-2 * expected[-1])
        for other in by.values():
            np.testing.assert_allclose(other, 0.0, atol=1e-5)  # the explicit one chatters
        np.testing.assert_allclose(energy.kinetic[0], 5.0)
        np.testing.assert_allclose(energy.kinetic, 5.0 - energy.dissipated, atol=1e-6)

    def test_turning_counts_and_so_does_the_way_downhill(self):
        run = sorted_on_a_slope()
        energy, parcel = run.energy, run.run.parcel
        # The centre of mass from the base's frame.
        x, y = parcel.centre_of_mass
        theta, (vx, vy, omega) = run.pose[:, 2], run.velocity.T
        arm_x, arm_y = x * np.cos(theta) - y * np.sin(theta), x * np.sin(theta) + y * np.cos(theta)
        vx, vy = vx - omega * arm_y, vy + omega * arm_x
        expected = 0.5 * parcel.mass * (vx**2 + vy**2) + 0.5 * parcel.moment_of_inertia * omega**2
        np.testing.assert_allclose(energy.kinetic, expected, rtol=1e-12)
        centre = run.pose[:, 0] + arm_x
        height = -(centre - centre[0]) * math.sin(run.run.surface.tilt)
        np.testing.assert_allclose(energy.potential, parcel.mass * G * height, atol=1e-12)


def test_contacts_acceleration_and_energy_take_a_run():
    run, at_rest = sorted_on_a_slope(), (sg.layouts.sorting(), [BOX], [(1.0, 1.0, 0.0)])
    for trajectory in (
        Trajectory(run.time, run.pose, run.velocity, run.tipping, run.end),
        sg.simulate_together(*at_rest, duration=0.02).trajectories[0],
    ):
        for asked in ("contacts", "acceleration", "energy"):
            message = f"^{asked} needs a trajectory with a run"
            with pytest.raises(ValueError, match=message):
                getattr(trajectory, asked)


def test_what_another_engine_moved_has_no_run():
    pytest.importorskip("mujoco")
    from surface_gym.validation import simulate

    start = (BOX, sg.layouts.start("S"), (1.0, 0.0, 0.0))
    assert simulate(sg.layouts.sorting(), *start, duration=0.01).run is None
