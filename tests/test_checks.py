"""Checks of arguments: each error names the argument, what came and what is allowed."""

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import checks
from surface_gym.design.case import Case, TurnPurpose, Unknown
from surface_gym.design.limits import least_tilt
from surface_gym.flow.arrivals import Arrival, Poisson, Schedule, Spread, Steady
from surface_gym.flow.exits import Exit, flow_line
from surface_gym.flow.stream import Stream
from surface_gym.lines import Field, Line
from surface_gym.sensors import Camera, Entry, Presence
from surface_gym.tasks.paths import LaneChange, Polyline, Sine
from surface_gym.tasks.start import Start
from tests.environments import batch_with
from tests.flow.flows import SHORT
from tests.test_any_input import run_or_refusal

NOT_A_NUMBER = [None, "a", "1.0", b"1", True, np.True_, 1j, [1.0], np.array([1.0]), 10**400]
NOT_FINITE = [math.nan, math.inf, -math.inf, np.float32("nan")]


@pytest.mark.parametrize("value", [*NOT_A_NUMBER, *NOT_FINITE], ids=lambda value: repr(value)[:20])
@pytest.mark.parametrize(
    "check", [checks.number, checks.positive, checks.not_negative], ids=lambda c: c.__name__
)
def test_what_is_no_finite_number_is_refused(check, value):
    with pytest.raises(ValueError, match=r"^mass must be a finite number, got "):
        check("mass", value)


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2.0), np.int64(2), np.float64(2.0)])
def test_numbers_of_any_kind_become_floats(value):
    for check in (checks.number, checks.positive, checks.not_negative):
        assert check("mass", value) == 2.0
        assert type(check("mass", value)) is float


MESSAGES: list[tuple[Callable[..., Any], tuple[Any, ...], str]] = [
    (checks.positive, (0.0,), "be greater than 0, got 0.0"),
    (checks.positive, (5, 1.0, 4.0), "be between 1 and 4, got 5"),
    (checks.not_negative, (-1e-9,), "be at least 0, got -1e-09"),
    (checks.not_negative, (5, 4.0), "be between 0 and 4, got 5"),
    (checks.within, (2, 0, 1), "be between 0 and 1, got 2"),
    (checks.integer, (9, 1, 8), "be a whole number of at most 8, got 9"),
    *(
        (checks.integer, (value, 1), f"be a whole number of at least 1, got {value!r}")
        for value in (0, 1.0, True, None, "3")
    ),
    (checks.path, (5,), "be a path, got 5"),
    (checks.array, (np.ma.zeros(2), (2,)), "be an array of numbers, got a masked one"),
    (checks.one_of, ("M", "SB"), "be one of 'S', 'B', got 'M'"),
    (checks.one_of, (True, (1, -1)), "be one of 1, -1, got True"),
    (checks.one_of, ([1], (1, -1)), "be one of 1, -1, got [1]"),
    (checks.limited, (np.array([1.0, -3.0]), 2.0), "be between -2 and 2, got -3 in it"),
    (
        checks.limited, (np.array([[1.0, 1.0], [2.0, 3.5]]), (2.0, 3.0)),
        "be between -3 and 3, got 3.5 in it",
    ),
    (checks.pose, ((1e5, 0.0, 0.0), (3,)), "be between -10000 and 10000, got 100000 in it"),
    (
        checks.velocity, ([(0.0, 0.0, -2e3)], (None, 3)),
        "be between -1000 and 1000, got -2000 in it",
    ),
    (checks.angle, (45.0,), f"be between -6.28319 and 6.28319 rad, got 45.0; {checks.DEGREES}"),
    (checks.angle, (-0.1, 0.0, 1.0), f"be between 0 and 1 rad, got -0.1; {checks.DEGREES}"),
    (
        checks.angles, (np.array([0.0, -90.0]),),
        f"be between -6.28319 and 6.28319 rad, got -90 in it; {checks.DEGREES}",
    ),
    (checks.instance, (3, Field, "a Field"), "be a Field, got 3"),
    (checks.instance, (Field, Line, "a Line"), f"be a Line, got {Field!r}"),
    (checks.instance, (Field, Field, "a Field"), f"be a Field, got {Field!r}; call it: Field()"),
    (checks.instance, (Steady, Steady, "one"), f"be one, got {Steady!r}; call it: Steady(...)"),
    (checks.place, ((0.0, -2e4),), "be between -10000 and 10000, got -20000 in it"),
    (checks.friction, ([[1.0, 101.0]], (1, 2)), "be at most 100, got 101.0"),
    (checks.orientations, (np.linspace(0.0, 1.0, 1001),), "be at most 1000, got 1001"),
    (checks.orientations, ((0.0, 1.0, 0.0),), "differ from each other, got (0.0, 1.0, 0.0)"),
    (checks.orientations, ((0.0, math.pi),), f"hold two axes that differ, got {(0.0, math.pi)!r}"),
]  # fmt: skip


@pytest.mark.parametrize(("check", "given", "message"), MESSAGES)
def test_messages(check, given, message):
    with pytest.raises(ValueError, match=f"^a must {re.escape(message)}$"):
        check("a", *given)


def test_what_is_allowed_passes():
    turn = np.float32(2.0 * math.pi)  # a little more than a turn
    assert checks.angle("a", turn) == turn
    assert checks.angles("a", np.float64([turn, -turn])).tolist() == [turn, -turn]
    assert checks.observation([1], (1,)).dtype == np.float32
    assert checks.not_negative("mu", 0) == 0.0
    assert checks.within("a", 0, 0, 1) == 0.0
    assert checks.within("a", 1, 0, 1) == 1.0
    assert checks.integer("n", np.int32(4), 4) == 4
    assert checks.one_of("size", "S", ("S", "B")) == "S"
    assert checks.one_of("size", np.str_("S"), ("S", "B")) == "S"
    assert type(checks.one_of("side", np.int64(1), (1, -1))) is int


NO_ARRAYS = [
    None, "abc", ("1", "2", "3"), ("a", 2, 3), (True, False, True), np.array([1 + 0j, 2, 3]),
    [[1.0], [1.0, 2.0], 3.0], (None, 2, 3), (10**400, 2, 3), [object(), 2, 3], {1, 2, 3},
]  # fmt: skip


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (NO_ARRAYS, "be an array of numbers, got "),
        ([1.0, (1.0, 2.0), np.zeros((3, 1)), np.zeros(0)], r"have the shape \(3\), got \("),
        ([(0.0, value, 1.0) for value in NOT_FINITE], "be finite, got -?(nan|inf) in it$"),
    ],
)
def test_what_is_no_array_of_three_numbers_is_refused(values, message):
    for value in values:
        with pytest.raises(ValueError, match=f"^pose must {message}"):
            checks.array("pose", value, (3,))


def test_an_array_is_a_read_only_copy():
    mine = np.array([1.0, 2.0, 3.0])
    theirs = checks.array("pose", mine, (None,))
    mine[0] = 9.0
    assert theirs.tolist() == [1.0, 2.0, 3.0]
    assert theirs.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        theirs[0] = 9.0
    assert checks.array("pose", np.array([1, 2], dtype=np.int8), (2,)).tolist() == [1.0, 2.0]


AXES, ROTORS = np.zeros((2, 3)), np.ones((2, 3), dtype=bool)
BOX = sg.Rectangle(0.25, 0.25)
ON_IT = (sg.layouts.sorting(), sg.layouts.box("S"), (0.5, 1.0, 0.0))


def surface(**fields: Any) -> sg.Surface:
    return sg.Surface(AXES, ROTORS, **fields)


def flow(**arguments: Any) -> sg.SmartSurfaceEnv:
    return sg.SmartSurfaceEnv("flow", line=SHORT, **arguments)


def uneven(most: Any) -> sg.Surface:
    return surface(stiffness=[[1.0, 1.0, 1.0], [1.0, 1.0, most]])


def beside(**changes: Any) -> Any:
    arguments = {"parcels": [ON_IT[1]], "poses": [ON_IT[2]], **changes}
    return sg.simulate_together(ON_IT[0], **arguments)


TURN = 2.0 * math.pi
NUMBER, SHARE, COEFFICIENT = (-1e4, 1e4), (0.0, 0.9999), (0.0, 100.0)
OBSERVER = {
    "drop": SHARE, "mu_max": COEFFICIENT, "mu_min": COEFFICIENT, "mu_support": COEFFICIENT,
    "friction_error": (0.0, 10.0), "acceleration_density": (1e-12, 1e9),
    "turn_density": (1e-12, 1e9),
}  # fmt: skip
# Fields of each kind, with the least and greatest that they may be.
FIELDS: dict[Callable[..., Any], dict[str, tuple[float, float]]] = {
    surface: {"pitch": (1e-4, 1e3), "mu_support": COEFFICIENT, "tilt": (-0.7853, 0.7853)},
    beside: {"restitution": (0.0, 1.0), "side_friction": COEFFICIENT},
    sg.Actuators: {"stuck_share": (0.0, 1.0)},
    sg.Randomisation: {"friction": SHARE, "stiffness": (0.0, 2.0), "heading": (0.0, math.pi)},
    sg.SmartSurfaceEnv: {"control_period": (1e-6, 10.0)},
    Field: {"pitch": (1e-4, 1e3)},
    Line: {"line_y": (0.2, 1.8)},
    Camera: {
        "frame_rate": (1e-3, 1e6), "latency": (0.0, 0.16), "position_noise": (0.0, 10.0),
        "angle_noise": (0.0, 2.0 * math.pi), **OBSERVER,
    },
    Presence: {"sample_rate": (1e-3, 1e6), "tolerance": (1e-6, 1.0), **OBSERVER},
    Entry: {
        "position": (0.0, 10.0), "angle": (0.0, 2.0 * math.pi), "speed": (0.0, 100.0),
        "turning": (0.0, 1e3),
    },
    flow: {
        "duration": (0.04, 86_400.0), "control_period": (1e-6, 10.0), "patience": (1e-6, 86_400.0),
        "tilt": (-0.2617, 0.2617), "entry_gap": (0.0, SHORT.length), "ahead": (0.0, 100.0),
        "side_friction": COEFFICIENT,
    },
    Sine: {"amplitude": NUMBER, "wavelength": (1e-4, 1e3)},
    LaneChange: {"length": (1e-4, 1e3)},
}  # fmt: skip
# By the name of each: what takes it, and the least and greatest that it may be.
NUMBERS: dict[str, tuple[Callable[[Any], Any], float, float]] = {
    "Surface.axis": (lambda v: sg.Surface([[0.0, v]], [[True, True]]), -TURN, TURN),
    "Surface.pitch in y": (lambda v: surface(pitch=(0.1, v)), 1e-4, 1e3),
    "Surface.origin": (lambda v: surface(origin=(0.0, v)), -1e4, 1e4),
    "Surface.mu_max": (lambda v: surface(mu_max=v, mu_min=0.0), 0.0, 100.0),
    "Surface.mu_min": (lambda v: surface(mu_max=100.0, mu_min=v), 0.0, 100.0),
    "Surface.mu_support of one": (
        lambda v: surface(mu_support=[[0.0, 0.0, 0.0], [0.0, 0.0, v]]), 0.0, 100.0,
    ),
    "Surface.stiffness": (uneven, 1e-6, 1e6),
    "Rectangle.length": (lambda v: sg.Rectangle(v, 0.2), 1e-4, 1e3),
    "Rectangle.width": (lambda v: sg.Rectangle(0.2, v), 1e-4, 1e3),
    "Disc.radius": (sg.Disc, 1e-4, 1e3),
    "Polygon.vertices": (lambda v: sg.Polygon([(0, 0), (v, 0), (0, 1)]), -1e3, 1e3),
    "Parcel.mass": (lambda v: sg.Parcel(BOX, mass=v), 1e-6, 1e6),
    "Parcel.com_height": (lambda v: sg.Parcel(BOX, com_height=v), 0.0, 100.0),
    "Parcel.inertia": (lambda v: sg.Parcel(BOX, inertia=v), 3.1251e-7, 312_499.0),
    "Parcel.com_offset": (lambda v: sg.Parcel(BOX, com_offset=(v, 0.0)), -0.125, 0.125),
    "simulate.pose": (lambda v: sg.simulate(*ON_IT[:2], (0.5, v, 0.0)), 0.0, 2.0),
    "simulate.pose turned": (lambda v: sg.simulate(*ON_IT[:2], (0.5, 1.0, v)), -1e6, 1e6),
    "simulate.velocity": (lambda v: sg.simulate(*ON_IT, (v, 0.0, 0.0), dt=1e-4), -100.0, 100.0),
    "simulate.velocity turning": (lambda v: sg.simulate(*ON_IT, (0.0, 0.0, v), dt=1e-4), -1e3, 1e3),
    "simulate.duration": (lambda v: sg.simulate(*ON_IT, duration=v, dt=1.0), 1e-9, 1e6),
    "simulate.dt": (lambda v: sg.simulate(*ON_IT, duration=1e-3, dt=v), 1e-6, 1.0),
    "together.poses": (lambda v: beside(poses=[(v, 1.0, 0.0)]), -0.01, 4.01),
    "together.velocities": (
        lambda v: beside(velocities=[(0.0, 0.0, v)], dt=1e-4, duration=0.001), -1e3, 1e3,
    ),
    "together.duration": (lambda v: beside(duration=v, dt=1.0), 1e-9, 1e6),
    "together.dt": (lambda v: beside(duration=1e-3, dt=v), 1e-6, 1.0),
    "Field.origin": (lambda v: Field(origin=(v, 0.0)), -1e4, 1e4),
    "Field.mu_max": (lambda v: Field(mu_max=v, mu_min=0.0), 0.0, 100.0),
    "env.lateral": (
        lambda v: sg.SmartSurfaceEnv(randomisation=sg.Randomisation(lateral=v)), 0.0, 0.5,
    ),
    "Steady.rate": (Steady, 1e-6, 1e5),
    "Spread.rate": (lambda v: Spread(v, 0.1), 1e-6, 1e5),
    "Spread.spread": (lambda v: Spread(900.0, v), 0.0, 0.9999),
    "Poisson.rate": (Poisson, 1e-6, 1e5),
    "Schedule.spread": (lambda v: Schedule(((0.0, 900.0),), v), 0.0, 0.9999),
    "Poisson.least_gap": (lambda v: Poisson(900.0, v), 0.0, 4.0),
    "Schedule.rate": (lambda v: Schedule(((0.0, 900.0), (1.0, v))), 0.0, 1e5),
    "Stream.odds": (lambda v: Stream(parcels=(("S", v),)), 1e-9, 1e9),
    "Arrival.time": (lambda v: Arrival(v, ON_IT[1], 1.0, "left"), 0.0, 1e9),
    "Exit.first": (lambda v: Exit("left", 1, v), -1e4, 1e4),
    "flow_line.length": (flow_line, 0.5505, 1e3),
    "Polyline.points": (lambda v: Polyline(((0.0, v), (1.0, 1.0))), -1e4, 1e4),
    **{
        f"{kind.__name__}.{name}": (lambda v, kind=kind, name=name: kind(**{name: v}), *bounds)
        for kind, fields in FIELDS.items()
        for name, bounds in fields.items()
    },
}  # fmt: skip
NO_NUMBERS = [None, "1", b"1", 1j, [[1.0]], {}, math.nan, math.inf, -math.inf, object()]
# Where nothing given means something.
ABSENT = {"Parcel.inertia", "Camera.latency"} | {
    f"{kind}.mu_{name}" for kind in ("Camera", "Presence") for name in ("max", "min", "support")
}


@pytest.mark.parametrize("name", NUMBERS)
def test_what_is_beyond_the_bounds_is_refused_by_name(name):
    call, least, most = NUMBERS[name]
    named = name.partition(".")[2].partition(" ")[0]
    far = [1.001, 2.0, 1e3, 1e300]
    below = [least / factor if least > 0.0 else least - 1e-3 * factor for factor in far]
    for wrong in (*below, *(most * factor for factor in far), -1e308, 1e308, *NO_NUMBERS):
        if (wrong is None and name in ABSENT) or (wrong == -math.inf and name == "Exit.first"):
            continue
        with pytest.raises(ValueError, match=rf"\b{named}s? .*must "):
            call(wrong)


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
@pytest.mark.parametrize("name", [name for name in NUMBERS if "duration" not in name])
def test_the_bounds_themselves_are_allowed(name):
    call, least, most = NUMBERS[name]
    for value in (least, most):
        run_or_refusal(lambda value=value: call(value))


DEGREES = {
    "axis": lambda: sg.Surface([[45.0]], [[True]]),
    "tilt": lambda: surface(tilt=15),
    "task_axis": lambda: sg.layouts.line([[45.0]]),
    "angle": lambda: sg.layouts.slowing(angle=45),
    "orientations": lambda: sg.SmartSurfaceEnv(orientations=(0, 45, -45, 90)),
    "orientations of a line": lambda: Field(orientations=(0.0, 90.0)),
    "heading": lambda: sg.Randomisation(heading=5.0),
    "angle_noise": lambda: Camera(angle_noise=10.0),
    "entry_turn": lambda: sg.tasks.Sort(entry_turn=10.0),
    "angles": lambda: sg.tasks.Orient(angles=(-45.0, 45.0)),
    "tilts": lambda: sg.tasks.Track(tilts=(0.0, 5.0)),
    "angle of a start": lambda: sg.SmartSurfaceEnv("orient").reset(options={"angle": 45}),
    "tilt of a start": lambda: sg.SmartSurfaceEnv("track").reset(options={"tilt": 5.0}),
    "angle of a purpose": lambda: TurnPurpose(30.0),
    "tolerance": lambda: TurnPurpose(0.5, tolerance=10.0),
    "tilt of a spread": lambda: Unknown(tilt=1.0),
    "highest": lambda: least_tilt(Case(ON_IT[1]), highest=15.0),
    "tilt of Sort.start": lambda: batch_with(Start(*ON_IT[1:], (1.0, 0.0, 0.0), (1.0,), tilt=5.0)),
    "tilt_direction of Sort.start": lambda: batch_with(
        Start(*ON_IT[1:], (1.0, 0.0, 0.0), (1.0,), tilt_direction=90.0)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DEGREES)
def test_an_angle_in_degrees_is_refused_and_the_error_says_how_it_is_given(name):
    named = name.partition(" of ")[0]
    with pytest.raises(ValueError, match=rf"^{named}\b.* must .*; {checks.DEGREES}$"):
        DEGREES[name]()


CROSSED = "mu_min must be at most mu_max, got 0.2 and 0.1"
WIDE = "lateral must be at most a quarter of the surface's width, 0.5 m, got 0.6"
ASIDE = sg.Randomisation(lateral=0.6)
LARGE = "rows times columns must be at most 1_000_000"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Camera(entry=None), "entry must"),
        (lambda: Presence(entry=3), "entry must"),
        (lambda: Presence(mu_max=0.1, mu_min=0.2), CROSSED),
        (lambda: surface(mu_max=0.1, mu_min=0.2), CROSSED),
        (lambda: uneven(1.1e6), r"stiffness must differ by a factor of at most 1e\+06, got 1 and "),
        (lambda: surface(stiffness=np.full((2, 3), 1e308)), "stiffness must be between 1e-09 and"),
        (lambda: Field(orientations=(0.3, 0.3 + math.pi)), "orientations must hold two axes that"),
        (lambda: sg.SmartSurfaceEnv(randomisation=ASIDE), WIDE),
        (lambda: Stream(speeds=0.0), "speeds must be greater than 0, got 0.0"),
        (lambda: Stream(speeds=1e308), r"speeds must be between 0 and 5, got 1e\+308"),
        (lambda: Schedule(((0.0, 900.0), (1e308, 0.0))), "times of rates must be between -1e"),
        (lambda: Field(rows=10_000, columns=1_000), LARGE),
        (lambda: flow_line(lead_in=10**9), "lead_in must be a whole number of at most 1000000"),
        (lambda: sg.tasks.Sort(speeds=(0.3, 1e308)), "speeds must be two rising numbers between 0"),
        (
            lambda: sg.SmartSurfaceEnv(sensors="camera"),
            r"sensors must be .*Presence\(\) of .*'camera'",
        ),
        (lambda: sg.SmartSurfaceEnv(sensors=Camera), r"sensors must .*; call it: Camera\(\)$"),
        (lambda: sg.SmartSurfaceEnv(sg.tasks.Sort), r"task must be .*; call it: Sort\(\)$"),
        (
            lambda: flow(stream="fast"),
            "stream must be a Stream .*Steady, Spread, Poisson, Schedule",
        ),
        (lambda: Stream(Poisson), r"arrivals must be .*; call it: Poisson\(\.\.\.\)$"),
        (
            lambda: sg.SmartSurfaceEnv(zone=(20, 3)),
            r"zone must be its first column and then its last, got \(20, 3\): the first, 20, is",
        ),
        (lambda: flow(entry_gap=1000), "entry_gap must be at most the line's length, 2.6 m, got"),
        (
            lambda: flow(exits=(Exit("left", 1, 0.0, 1.0), Exit("far", 1, 100.0, 200.0))),
            "exits must lie beside the rotors, from 0 to 2 m, got 'far' from 100 to 200 m",
        ),
        (lambda: sg.SmartSurfaceVectorEnv(2, threads=100_000), "threads must be at most 32 for"),
        (lambda: sg.Actuators(axis_speed=1e-308), "axis_speed must be between 1e-06 and"),
    ],
)
def test_nonsense_is_refused(call, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        call()


@pytest.mark.parametrize(
    ("pose", "velocity", "named"),
    [
        ((1e308, 1.0, 0.0), (1.0, 0.0, 0.0), "pose"),
        ((0.5, 1.0, 0.0), (0.0, 0.0, -1e4), "velocity"),
    ],
)
def test_a_task_may_start_nowhere_else(pose, velocity, named):
    with pytest.raises(ValueError, match=rf"{named} of Sort\.start must be between"):
        batch_with(Start(ON_IT[1], pose, velocity, (1.0,)))
