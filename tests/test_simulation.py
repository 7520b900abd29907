"""`simulate` against a finer step and other solvers, its ends, and bad arguments."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.surface import Surface
from tests.environments import run_python

BOX = sg.layouts.box("S")
START = sg.layouts.start("S")
DEFAULT = ("implicit", "dual")
METHODS, SOLVERS = ("implicit", "explicit"), ("dual", "osqp", "scipy")


class TestSteps:
    def test_the_implicit_step_meets_the_converged_explicit_one(self):
        """Medians as in the table of physics.md; its tails belong to its own 60 scenes, which it
        does not describe. Here they may be twice as long.
        """
        rng = np.random.default_rng(0)
        errors = []
        while len(errors) < 60:
            surface = sg.Surface(
                axis=rng.choice(np.radians([0.0, 45.0, -45.0, 90.0]), size=(30, 60)),
                rotor=rng.random((30, 60)) < 0.8,
                tilt=rng.choice([0.0, rng.uniform(0.0, np.radians(15.0))]),
            )
            parcel = sg.layouts.box(str(rng.choice(["S", "B"])))
            pose = (1.0, 1.5 + rng.uniform(-0.1, 0.1), rng.uniform(-np.pi, np.pi))
            velocity = (rng.uniform(0.5, 2.7), rng.uniform(-0.5, 0.5), rng.uniform(-3.0, 3.0))
            duration = rng.uniform(0.4, 1.0)
            fine = sg.simulate(surface, parcel, pose, velocity, duration, 1e-5, method="explicit")
            if fine.end != "duration" or fine.velocity[:, 0].min() <= 0.0:
                continue  # the paper's rules assume motion towards +x
            runs = (
                sg.simulate(surface, parcel, pose, velocity, duration, dt)
                for dt in (10e-3, 5e-3, 1e-3)
            )
            errors.append([run.pose[-1] - fine.pose[-1] for run in runs])
        x, y, theta = np.moveaxis(np.array(errors), -1, 0)
        position, angle = 1000.0 * np.hypot(x, y), np.degrees(np.abs(theta))  # [mm], [deg]
        # By step: 10 ms, 5 ms, 1 ms.
        assert (np.median(position, axis=0) <= 1.25 * np.array([1.9, 1.2, 0.23])).all()
        assert (np.median(angle, axis=0) <= 1.75 * np.array([0.30, 0.15, 0.04])).all()
        assert (np.quantile(position, 0.9, axis=0) <= 2.0 * np.array([7.1, 4.0, 0.78])).all()
        assert (position.max(axis=0) <= 2.0 * np.array([14.0, 9.7, 1.8])).all()

    def test_a_duration_below_the_step_is_one_step(self):
        run = sg.simulate(sg.layouts.sorting(), BOX, START, (1.5, 0, 0), 0.002, dt=0.005)
        one = sg.simulate(sg.layouts.sorting(), BOX, START, (1.5, 0, 0), 0.002, dt=0.002)
        np.testing.assert_array_equal(run.time, [0.0, 0.002])
        np.testing.assert_array_equal(run.pose, one.pose)

    @pytest.mark.parametrize("dt", [0.1, 0.01, 0.005, 0.001, 1 / 3, 1 / 7, 0.007])
    @pytest.mark.parametrize("duration", [0.3, 0.7, 1.0])
    def test_times_rise_to_the_duration(self, duration, dt):
        run = sg.simulate(sg.layouts.sorting(), BOX, START, duration=duration, dt=dt)
        assert run.time[0] == 0.0
        assert run.time[-1] == pytest.approx(duration, rel=1e-12)
        assert (np.diff(run.time) > 1e-6 * dt).all()
        np.testing.assert_allclose(np.diff(run.time)[:-1], dt, rtol=1e-9)
        assert len(run.time) == math.ceil(duration / dt - 1e-6) + 1

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("duration", [0.1, 0.1013])
    def test_every_solver_of_eq_1_gives_the_same_motion(self, method, duration):
        start = (sg.layouts.sorting(tilt=0.1), BOX, (0.6, 1.02, 0.3), (1.0, 0.1, -0.5))
        runs = [
            sg.simulate(*start, duration, method=method, normal_forces=solver) for solver in SOLVERS
        ]
        for run in runs[1:]:
            np.testing.assert_array_equal(run.time, runs[0].time)
            np.testing.assert_allclose(run.pose, runs[0].pose, rtol=0.0, atol=1e-6)
            np.testing.assert_array_equal(run.tipping, runs[0].tipping)


BRAKES = sg.Surface(np.zeros((20, 30)), np.ones((20, 30), dtype=bool))
SUPPORTS = sg.Surface(np.zeros((10, 10)), np.zeros((10, 10), dtype=bool))


class TestRest:
    @pytest.mark.parametrize("degrees", [-25.0, -5.0, 5.0, 25.0])
    def test_axes_along_the_slope_hold_a_parcel(self, degrees):
        surface = replace(BRAKES, tilt=math.radians(degrees))
        run = sg.simulate(surface, BOX, (1.5, 1.0, 0.2), duration=2.0)
        assert run.end == "duration"
        # It creeps by less than the rounding of friction, 1e-5 m/s.
        np.testing.assert_allclose(run.pose[-1], (1.5, 1.0, 0.2), atol=2.0e-5)

    def test_a_steeper_slope_moves_it(self):
        degrees = 28.0  # tan(28 deg) = 0.53 > mu_max
        surface = replace(BRAKES, tilt=math.radians(degrees))
        box = sg.Parcel(sg.Rectangle(0.5, 0.5), com_height=0.0)
        run = sg.simulate(surface, box, (0.8, 1.0, 0.0), duration=1.0)
        acceleration = 9.81 * (math.sin(surface.tilt) - 0.5 * math.cos(surface.tilt))
        assert run.pose[-1, 0] - 0.8 == pytest.approx(0.5 * acceleration, abs=1e-3)

    @pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, -90.0])
    def test_what_rolls_down_a_slope_gains_the_same_whatever_its_direction(self, degrees):
        direction, tilt = math.radians(degrees), math.radians(6.0)
        surface = sg.Surface(
            axis=np.full((40, 40), direction + math.pi / 2), rotor=np.ones((40, 40), dtype=bool),
            tilt=tilt, tilt_direction=direction,
        )  # fmt: skip
        way = np.round([math.cos(direction), math.sin(direction)])
        velocity = 0.2 * way
        run = sg.simulate(surface, BOX, (2.0, 2.0, 0.0), (*velocity, 0.0), duration=1.0)
        gain = 9.81 * (math.sin(tilt) - 0.01 * math.cos(tilt))
        expected = np.outer(0.2 + gain * run.time, way)
        np.testing.assert_allclose(run.velocity[:, :2], expected, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(run.velocity @ [way[1], way[0], 0.0], 0.0, atol=1e-15)
        way_gone = 0.2 * run.time + 0.5 * gain * run.time**2
        np.testing.assert_allclose((run.pose[:, :2] - 2.0) @ way, way_gone, rtol=0.0, atol=1e-9)


class TestEnds:
    @pytest.mark.parametrize(
        ("velocity", "method", "solver"),
        [
            *(((2.0, 0.0, 0.0), *each) for each in product(METHODS, SOLVERS)),
            *((v, *DEFAULT) for v in ((-2.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, -2.0, 1.0))),
        ],
    )
    def test_a_parcel_that_leaves_tips_first_and_the_run_says_so(self, velocity, method, solver):
        start = (SUPPORTS, BOX, (0.5, 0.5, 0.1), velocity, 2.0)
        run = sg.simulate(*start, method=method, normal_forces=solver)
        assert run.end == "left the surface"
        assert run.time[-1] < 1.0
        assert run.tipping[-1]
        assert not run.tipping[: len(run.time) // 2].any()
        assert len(run.time) == len(run.pose) == len(run.velocity) == len(run.tipping)
        assert np.isfinite(run.pose).all()
        # The last centre of mass is still over the grid, which ends half a pitch beyond its rim;
        # of the explicit method, that before it.
        last = run.pose[-1 if method == "implicit" else -2, :2]
        assert (np.abs(last - 0.5) <= 0.5).all()

    def test_a_parcel_over_fewer_than_three_elements_tips_all_along(self):
        rail = sg.Surface(np.full((1, 30), math.pi / 2), np.ones((1, 30), dtype=bool))
        with pytest.warns(sg.TippingWarning, match="100 of 100 steps, with 100% of all change"):
            run = sg.simulate(rail, BOX, (0.5, 0.05, 0.0), (1.0, 0.0, 0.0), duration=0.5)
        assert run.tipping[1:].all()
        assert run.end == "duration"
        expected = 0.5 + 0.5 - 0.5 * 0.01 * 9.81 * 0.25
        assert run.pose[-1, 0] == pytest.approx(expected, abs=1e-3)

    def test_few_steps_that_tip_a_parcel_and_those_of_one_at_rest_are_no_warning(self):
        rail = sg.Surface(np.full((1, 30), math.pi / 2), np.ones((1, 30), dtype=bool))
        assert sg.simulate(rail, BOX, (0.5, 0.05, 0.0)).tipping[1:].all()
        assert sg.simulate(sg.layouts.sorting(), BOX, START, (1.5, 0.0, 0.0)).tipping.sum() > 0


BIG = 2000


@pytest.fixture(scope="module")
def huge() -> Surface:
    rng = np.random.default_rng(3)
    return sg.Surface(
        axis=rng.choice(np.radians([0.0, 45.0, -45.0, 90.0]), size=(BIG, BIG)),
        rotor=rng.random((BIG, BIG)) < 0.8,
        pitch=0.125,
        origin=(0.0, 0.0),
    )


class TestLargeSurfaces:
    @pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
    @pytest.mark.parametrize("first", [(0, 0), (0, 1960), (1000, 1000), (1970, 0), (1970, 1960)])
    def test_a_window_gives_the_same_motion(self, huge, first):
        row, column = first
        rows, columns = slice(row, row + 30), slice(column, column + 40)
        origin = (float(huge.x[column]), float(huge.y[row]))
        window = replace(
            huge, axis=huge.axis[rows, columns], rotor=huge.rotor[rows, columns], origin=origin
        )
        pose = (origin[0] + 1.0, origin[1] + 1.5, 0.3)
        args = (BOX, pose, (2.0, 0.3, -1.0), 0.8)
        run, small = sg.simulate(huge, *args), sg.simulate(window, *args)
        assert run.end == small.end == "duration"
        np.testing.assert_allclose(run.pose, small.pose, rtol=0.0, atol=1e-9)
        assert any(first) or run.pose.tobytes() == small.pose.tobytes()


def test_a_new_process_gives_the_same_bits():
    code = (
        "import surface_gym as sg\n"
        "surface = sg.layouts.sorting('B', tilt=0.12)\n"
        "run = sg.simulate(surface, sg.layouts.box('B'), (1.0, 1.05, 0.4), (1.2, 0.1, -1.0))\n"
    )
    names: dict[str, Any] = {}
    exec(code, names)
    code += "print(run.pose.tobytes().hex())"
    printed = run_python("-W", "error", "-c", code, PYTHONHASHSEED="17")
    assert printed.strip() == names["run"].pose.tobytes().hex()


def test_a_run_leaves_its_arguments_as_they_were():
    pose, velocity = np.array([1.0, 1.0, 0.3]), np.array([1.0, 0.2, -0.5])
    surface = sg.layouts.sorting()
    axis = surface.axis.copy()
    run = sg.simulate(surface, BOX, pose, velocity, 0.2)
    np.testing.assert_array_equal(pose, (1.0, 1.0, 0.3))
    np.testing.assert_array_equal(velocity, (1.0, 0.2, -0.5))
    np.testing.assert_array_equal(surface.axis, axis)
    np.testing.assert_array_equal(run.pose[0], pose)
    np.testing.assert_array_equal(run.velocity[0], velocity)


def test_an_off_centre_frame_starts_where_it_is_put():
    triangle = sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.0, 0.3)])
    parcel = sg.Parcel(triangle, com_offset=(0.02, -0.01))
    run = sg.simulate(sg.layouts.sorting(), parcel, (1.0, 1.0, 0.7), (0.5, 0.2, 2.0), 0.005)
    np.testing.assert_allclose(run.pose[0], (1.0, 1.0, 0.7), atol=1e-12)
    np.testing.assert_allclose(run.velocity[0], (0.5, 0.2, 2.0), atol=1e-12)
    # Velocity is that of the frame reported, not of the centre of mass.
    mean = 0.5 * (run.velocity[0] + run.velocity[1])
    np.testing.assert_allclose((run.pose[1] - run.pose[0]) / 0.005, mean, atol=2e-2)


COIN = sg.Parcel(sg.Disc(0.04))  # which may lie between the elements


def test_a_base_that_comes_between_the_elements_is_told_from_one_that_leaves():
    field = sg.Surface(np.full((10, 30), math.pi / 2), np.ones((10, 30), dtype=bool))
    run = sg.simulate(field, COIN, (1.05, 0.55, 0.0), (1.0, 0.0, 0.0))
    assert run.end == "nothing bears it"
    assert run.pose[-1, 0] == pytest.approx(1.09, abs=0.01)  # 4 cm past the element
    rim = sg.simulate(field, COIN, (2.95, 0.55, 0.0), (5.0, 0.0, 0.0), dt=0.015)
    assert rim.end == "left the surface"


GOOD: dict[str, object] = {"surface": sg.layouts.sorting(), "parcel": BOX, "pose": (1.0, 1.0, 0.0)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"surface": "sorting"}, "surface must be a Surface, got 'sorting'"),
        ({"parcel": sg.Disc(0.2)}, r"parcel must be a Parcel, got Disc\(radius=0.2\)"),
        ({"pose": (1.0, 1.0)}, r"pose must have the shape \(3\), got \(2,\)"),
        ({"pose": (-0.2, 1.0, 0.0)}, r"pose must be on the surface.*, got \(-0.2, 1.0, 0.0\)"),
        ({"pose": (1.0, 9.0, 0.0)}, r"pose must be on the surface.*, got \(1.0, 9.0, 0.0\)"),
        ({"parcel": COIN}, r"pose must be over an element, got \(1.0, 1.0, 0.0\)"),
        ({"dt": 1.0, "velocity": (1.5, 0.0, 0.0)}, "dt must be so short that no step moves"),
        ({"dt": 0.05, "velocity": (0.1, 0.0, 12.0)}, "dt must be so short that no step moves"),
        ({"method": "explicit", "velocity": (0.0, 1.5, 0.0)}, r"velocity must be towards \+x for "),
        ({"method": "explicit", "velocity": (-1.5, 0.0, 0.0)}, r"velocity must be towards \+x"),
        ({"velocity": (1.0, 0.0)}, r"velocity must have the shape \(3\), got \(2,\)"),
        ({"method": "euler"}, "method must be one of 'implicit', 'explicit', got 'euler'"),
        ({"normal_forces": "qp"}, "normal_forces must be one of 'dual', .*, got 'qp'"),
        (
            {"method": "explicit", "surface": sg.layouts.sorting(tilt=-0.1)},
            "tilt must be at least 0 for the explicit method, got -0.1",
        ),
        (
            {"method": "explicit", "surface": replace(BRAKES, tilt=0.1, tilt_direction=1.5)},
            r"tilt_direction must be 0, towards \+x, for the explicit method, got 1\.5",
        ),
    ],
)
def test_what_is_not_allowed_is_refused(changes, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        sg.simulate(**{**GOOD, **changes})


def test_runs_in_threads_and_after_others_are_the_same():
    """A thread's runs share their scratch, which holds what lay under the parcel of the last."""
    rotor = np.ones((20, 30), dtype=bool)
    surfaces = [sg.Surface(np.tile(axes, (20, 10)), rotor) for axes in ([1.4, 1.8, 1.5], [1.7] * 3)]
    runs = [(surface, size) for size in ("B", "S") for surface in 2 * surfaces]

    def end(run: tuple[Surface, str]) -> list[float]:
        surface, size = run
        start = (0.5, 1.0, 0.1)
        found = sg.simulate(surface, sg.layouts.box(size), start, (1.0, 0.1, 0.2), 0.005)
        return [*found.pose[-1], *found.velocity[-1]]

    alone = []
    for run in runs:
        with ThreadPoolExecutor(1) as fresh:  # with a scratch of its own
            alone.append(fresh.submit(end, run).result())
    assert [end(run) for run in runs] == alone
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(end, 50 * runs)) == 50 * alone
