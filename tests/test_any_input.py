"""Nothing that is allowed gives a number that is none, a hang or a crash.

Numbers up to the bounds of `surface_gym.checks` are drawn by Hypothesis. The examples of a test
share one compiled kernel. `HYPOTHESIS_PROFILE=nightly` has more of them, and every kernel.
"""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import surface_gym as sg
from surface_gym import checks
from surface_gym.compiler.jit import kernel_function
from surface_gym.flow.arrivals import Law, Poisson, Schedule, Spread, Steady
from surface_gym.flow.stream import Stream
from surface_gym.lines import Pattern
from surface_gym.parcel import Base
from surface_gym.physics.types import Array
from surface_gym.sensors import AdaptiveCamera, Camera, Entry, Exact, Presence, Sensor
from surface_gym.state import EnvState
from surface_gym.tasks import TASKS
from tests.environments import ACTIONS
from tests.flow.flows import SHORT
from tests.strategies import Scene, polygon_vertices

# Refused for what only a run shows: where the parcel lies, or how far a step takes it.
PLACE = (
    "dt must be so short that no step moves",
    "pose must be ",
    "poses must be ",
    "poses must leave parcels apart",
    "tilt must be at least 0 for the explicit method",
    "tilt_direction must be 0, towards +x, for the explicit method",
    "velocity must be towards +x for the explicit method",
)
# 100 examples; as many as the profile asks for, where those are more.
any_input = settings(
    max_examples=max(100, settings.default.max_examples),
    suppress_health_check=[HealthCheck.too_slow],  # where the machine is busy
)

Numbers = st.SearchStrategy[float]


def run_or_refusal(run: Callable[[], Any]) -> Any:
    """What a run comes to; None where it is refused for what only a run shows."""
    try:
        return run()
    except ValueError as error:
        message = str(error)
        if not message.startswith(PLACE) or " nan " in message or " inf " in message:
            raise
    return None


def sizes(least: float, most: float) -> Numbers:
    """Any order of magnitude, and both ends."""
    low, high = math.log10(least), math.log10(most)
    drawn = st.floats(low, high).map(lambda exponent: min(most, max(least, 10.0**exponent)))
    return st.one_of(st.sampled_from([least, most]), drawn)


def up_to(most: float) -> Numbers:
    return st.one_of(st.just(0.0), sizes(1e-12 * most, most))


def either_way(most: float) -> Numbers:
    return st.builds(math.copysign, up_to(most), st.sampled_from([1.0, -1.0]))


@st.composite
def surfaces(draw: st.DrawFn, columns: tuple[int, int] = (1, 12)) -> sg.Surface:
    """Some elements, of whatever is allowed; as many columns as from the first to the second."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = draw(st.tuples(st.integers(1, 12), st.integers(*columns)))
    pitch = draw(sizes(*checks.LENGTH))
    other = pitch * draw(st.sampled_from([1.0, 0.1, 10.0]))
    mu_max = draw(up_to(checks.FRICTION))
    decades = draw(st.sampled_from([0.0, 3.0, math.log10(checks.STIFFNESS_RATIO) - 1e-9]))
    at = either_way(0.5 * checks.FARTHEST)
    return sg.Surface(
        axis=draw(st.sampled_from([math.pi, checks.TURN])) * rng.uniform(-1.0, 1.0, shape),
        rotor=rng.random(shape) < draw(st.sampled_from([0.0, 0.5, 1.0])),
        pitch=(pitch, min(max(other, checks.LENGTH[0]), checks.LENGTH[1])),
        origin=(draw(at), draw(at)),
        mu_max=mu_max,
        mu_min=mu_max * draw(st.sampled_from([0.0, 1e-6, 0.02, 1.0])),
        mu_support=draw(up_to(checks.FRICTION)),
        tilt=draw(st.sampled_from([0.0, 0.1, 0.7853, -0.7853])),
        tilt_direction=draw(st.sampled_from([0.0, 0.0, math.pi / 2, 4.0])),
        stiffness=draw(sizes(1e-9, 1e3)) * 10.0 ** (decades * rng.random(shape)),
    )


WHOLE_RANGE = st.one_of(st.floats(0.8, 3.0), sizes(0.1, 30.0))


@st.composite
def bases(draw: st.DrawFn, scale: float, shares: Numbers) -> Base:
    def length() -> float:
        drawn = scale * draw(shares)
        return min(max(drawn, checks.LENGTH[0]), 0.5 * checks.LENGTH[1])

    kind = draw(st.sampled_from(["rectangle", "disc", "polygon"]))
    if kind == "rectangle":
        return sg.Rectangle(length(), length())
    if kind == "disc":
        return sg.Disc(length())
    flatten, turn = draw(st.floats(0.05, 1.0)), draw(st.floats(-4.0, 4.0))
    return sg.Polygon(polygon_vertices(draw(st.integers(3, 7)), max(length(), 1e-3), flatten, turn))


@st.composite
def parcels(draw: st.DrawFn, scale: float, shares: Numbers = WHOLE_RANGE) -> sg.Parcel:
    base = draw(bases(scale, shares))
    mass = draw(sizes(*checks.MASS))
    radius = draw(st.none() | sizes(*checks.GYRATION).map(lambda share: share * base.reach))
    inner = 0.2 * min(base.edges[:, 2], default=base.reach)
    inside = st.floats(-inner, inner)
    return sg.Parcel(
        base,
        mass=mass,
        com_height=draw(up_to(checks.COM_HEIGHT)),
        inertia=None if radius is None else mass * radius**2,
        com_offset=draw(st.tuples(inside, inside)),
    )


velocities = st.tuples(either_way(checks.SPEED), either_way(checks.SPEED), either_way(checks.SPIN))


@st.composite
def places(draw: st.DrawFn, surface: sg.Surface) -> tuple[float, float, float]:
    """A pose near an element or midway between two, turned any way."""
    x, y = (
        float(draw(st.sampled_from(line.tolist())) + draw(st.sampled_from([0.0, 0.2, 0.5])) * pitch)
        for line, pitch in ((surface.x, surface.pitch_x), (surface.y, surface.pitch_y))
    )
    return (x, y, draw(either_way(checks.TURNED)))


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """A parcel over a surface, both of whatever is allowed."""
    surface = draw(surfaces())
    parcel = draw(parcels(max(surface.pitch_x, surface.pitch_y)))
    return Scene(surface, parcel, draw(places(surface)), draw(velocities))


@st.composite
def crowds(draw: st.DrawFn) -> tuple[sg.Surface, dict[str, Any]]:
    """Parcels one behind the other, some of which touch, and what `simulate_together` takes."""
    surface = draw(surfaces(columns=(20, 40)))
    count = draw(st.integers(1, 4))
    dt = draw(sizes(*checks.STEP))
    scale = max(surface.pitch_x, surface.pitch_y)
    kinds = [draw(parcels(scale, st.floats(1.0, 2.5))) for _ in range(count)]
    _, y, theta = draw(places(surface))
    x = float(surface.x[0]) - kinds[0].base.reach
    poses = []
    for kind in kinds:
        poses.append((x + kind.base.reach, y, theta))
        x += draw(st.sampled_from([1.5, 2.0])) * kind.base.reach * (1.0 + draw(up_to(0.1)))
    # No faster than the step allows: the others would all be refused.
    fastest = min(checks.SPEED, 0.5 * min(surface.pitch_x, surface.pitch_y) / dt)
    speeds = st.one_of(st.just(fastest), either_way(fastest))
    return surface, {
        "parcels": kinds,
        "poses": poses,
        "velocities": [((-1.0) ** k * draw(speeds), 0.0, 0.0) for k in range(count)],
        "dt": dt,
        "duration": dt * draw(st.integers(1, 12)),
        "restitution": draw(st.floats(0.0, 1.0)),
        "side_friction": draw(up_to(checks.FRICTION)),
    }


positions, turns = up_to(checks.POSITION_ERROR), up_to(checks.ANGLE_ERROR)
rates = sizes(checks.FRAME_RATE[0], 100.0)
observing: dict[str, st.SearchStrategy[Any]] = {  # what any observer assumes
    "drop": st.floats(0.0, 0.999),
    "mu_max": st.none() | sizes(1.0, checks.FRICTION),
    "mu_min": st.none() | up_to(1.0),
    "mu_support": st.none() | up_to(checks.FRICTION),
    "friction_error": up_to(checks.FRICTION_ERROR),
    "acceleration_density": sizes(*checks.DENSITY),
    "turn_density": sizes(*checks.DENSITY),
    "entry": st.builds(Entry, positions, turns, up_to(checks.SPEED), up_to(checks.SPIN)),
}
filming = {"frame_rate": rates, "position_noise": positions, "angle_noise": turns, **observing}
learned = sizes(*checks.LEARNED_SPREAD)
SENSORS: dict[type[Sensor], st.SearchStrategy[Sensor]] = {
    Exact: st.just(Exact()),
    Camera: st.builds(Camera, **filming),
    AdaptiveCamera: st.builds(
        AdaptiveCamera, friction_spread=learned, load_spread=learned, **filming
    ),
    Presence: st.builds(
        Presence, sample_rate=rates, tolerance=sizes(*checks.TOLERANCE), **observing
    ),
}
SHARES = st.one_of(st.just(0.0), st.floats(0.0, 0.99))
# What every kernel does for alike: none of it is compiled in.
COMMON: dict[str, st.SearchStrategy[Any]] = {
    "control_period": sizes(checks.CONTROL_PERIOD[0], 0.2),
    "orientations": st.lists(
        either_way(checks.TURN), min_size=2, max_size=8, unique_by=lambda a: round(math.tan(a), 6)
    ).map(tuple),
    "randomisation": st.builds(
        sg.Randomisation,
        **dict.fromkeys(("friction", "rolling", "mass", "com_offset"), SHARES),
        stiffness=up_to(checks.STIFFNESS_SPREAD),
        lateral=up_to(0.5),
        heading=up_to(math.pi),
    ),
}
rates = sizes(checks.RATE[0], 20_000.0)
laws: st.SearchStrategy[Law] = st.one_of(
    st.builds(Steady, rates),
    st.builds(Spread, rates, SHARES),
    st.builds(Poisson, rates),
    st.builds(lambda rate, spread: Schedule(((0.0, rate), (0.5, 0.0)), spread), rates, SHARES),
)
streams = st.builds(
    lambda law, least, share: Stream(law, ("S", "B"), None, (least, least + share * (5.0 - least))),
    laws,
    sizes(1e-3, 5.0),
    st.floats(0.0, 1.0),
)

FEW = [  # of those whose code other tests need, too
    ("slow", AdaptiveCamera, "halves"), ("stop", Camera, "halves"), ("sort", Presence, "halves"),
    ("track", Exact, "modules"), ("orient", Exact, "modules"),
]  # fmt: skip
ALL = [(task, kind, actions) for task in TASKS for kind in SENSORS for actions in ACTIONS]
NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"


def assert_finite(trajectory: sg.Trajectory) -> None:
    assert np.isfinite(trajectory.pose).all()
    assert np.isfinite(trajectory.velocity).all()


@any_input
@given(
    scene=scenes(),
    dt=sizes(*checks.STEP),
    steps=st.integers(1, 12),
    method=st.sampled_from(["implicit", "explicit"]),
)
def test_simulate(scene, dt, steps, method):
    trajectory = run_or_refusal(lambda: scene.run(dt * steps, dt, method))
    if trajectory is not None:
        assert_finite(trajectory)


@any_input
@given(crowd=crowds())
def test_simulate_together(crowd):
    surface, arguments = crowd
    encounter = run_or_refusal(lambda: sg.simulate_together(surface, **arguments))
    if encounter is not None:
        for trajectory in encounter.trajectories:
            assert_finite(trajectory)
        assert np.isfinite(encounter.touches.impulse).all()


def play(env: gym.Env | gym.vector.VectorEnv, seed: int, periods: int = 4) -> None:
    """Random actions, begun anew where an episode ends."""
    env.action_space.seed(seed)
    observation, _ = env.reset(seed=seed)
    for _ in range(periods):
        assert np.isfinite(observation).all()
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
        if isinstance(env, gym.Env) and (terminated or truncated):
            observation, _ = env.reset()


@pytest.mark.parametrize(("task", "kind", "actions"), ALL if NIGHTLY else FEW)
def test_environments(task, kind, actions):
    @any_input
    @given(
        settings=st.fixed_dictionaries({"sensors": SENSORS[kind], **COMMON}),
        seed=st.integers(0, 1000),
        num_envs=st.integers(0, 3),
    )
    def check(settings: dict[str, Any], seed: int, num_envs: int) -> None:
        many = partial(sg.SmartSurfaceVectorEnv, num_envs)
        make = many if num_envs else sg.SmartSurfaceEnv
        play(make(task, actions=actions, **settings), seed)

    check()


@pytest.mark.parametrize("kind", SENSORS if NIGHTLY else [Exact])
def test_flows(kind):
    @any_input
    @given(
        settings=st.fixed_dictionaries({"sensors": SENSORS[kind], "stream": streams, **COMMON}),
        duration=sizes(0.2, checks.EPISODE),
        seed=st.integers(0, 1000),
    )
    def check(settings: dict[str, Any], duration: float, seed: int) -> None:
        settings = {"line": SHORT, "max_parcels": 4, "duration": min(duration, 20.0), **settings}
        play(sg.SmartSurfaceEnv("flow", **settings), seed)

    check()


def test_a_pattern_may_lie_far_away():
    far = Pattern([[True] * 20] * 6, origin=(9_000.0, -9_000.0))
    play(sg.SmartSurfaceEnv(line=far), seed=0)


@dataclass(frozen=True)
class Wild(Sensor):
    says: float = math.nan

    def numbers(self, dt: float) -> tuple[float, ...]:
        del dt
        return (self.says,)

    @staticmethod
    @kernel_function
    def read(numbers: Array, state: EnvState) -> None:
        for k in range(state.sensed.shape[0]):
            state.sensed[k] = state.truth[k] if state.steps == 0 else numbers[0]


@pytest.mark.parametrize("says", [math.nan, math.inf, -math.inf, 1e308, -1e308, 1e19, 0.0])
def test_whatever_a_sensor_says_reaches_no_other_memory(says):
    env = sg.SmartSurfaceEnv("sort", actions="window", sensors=Wild(says), observe_axes=True)
    if abs(says) < 1e30:  # an observation is float32
        play(env, seed=0)
        return
    env.reset(seed=0)
    for _ in range(5):  # each acts on what was said before
        with pytest.raises(ValueError, match="must write finite features"):
            env.step(np.full(25, 1))
