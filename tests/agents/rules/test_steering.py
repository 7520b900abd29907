"""Rules of Track and Orient with the model they predict by, and the rule for driven modules."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.evaluation.method import FIXED
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.rules import decoding, steering
from surface_gym.agents.rules.decoding import Motion, look_at_line, look_at_path
from surface_gym.agents.rules.layouts import FixedTurning
from surface_gym.agents.rules.steering import AIMS, AimRule, towards
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.modules import Belt, OmniModule, SteeredRoller
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks.paths import Sine
from tests.agents.rules.runs import Scripted, begun, mirrored_starts, run, run_rule
from tests.environments import MINUS_45, PLUS_45, ROLL

# Compiled as Python calls them.
see_line, see_path = compiled(decoding.see_line.py_func), compiled(decoding.see_path.py_func)
place_modules = compiled(steering.place_modules.py_func)
predict = compiled(steering.predict.py_func)
choose_turn = compiled(steering.choose_turn.py_func)

WAVES = [
    {"parcel": parcel, "speed": speed, "tilt": math.radians(tilt), "path": Sine(side * 0.15, 2.5)}
    for parcel in "SB"
    for speed in (0.7, 0.9)
    for tilt in (12.0, 14.0)
    for side in (1, -1)
]
TURNS = [
    {"parcel": parcel, "speed": 1.5, "angle": math.radians(angle)}
    for parcel in "SB"
    for angle in (-30.0, -15.0, 15.0, 30.0)
]


@pytest.mark.parametrize(
    ("name", "farthest", "slowest"),
    [
        ("threshold logic", 0.012, 0.25),
        ("PID per module", 0.01, 0.12),
        ("sliding mode", 0.006, 0.1),
    ],
)
def test_rules_follow_waves_that_rolling_leaves(name, farthest, slowest) -> None:
    runs = run_rule("track", name, WAVES)
    assert runs.success.mean() > 0.9
    assert runs.metrics["rms_error"].mean() < farthest
    assert runs.metrics["speed_error"].mean() < slowest
    assert np.median(run_rule("track", "fixed layout", WAVES).metrics["rms_error"]) > 0.06


def test_sliding_mode_does_as_well_on_mirrored_paths() -> None:
    both = [run_rule("track", "sliding mode", some) for some in mirrored_starts("track")]
    assert all(each.success.all() for each in both)
    for figure in ("rms_error", "speed_error"):
        error, image = (each.metrics[figure].mean() for each in both)
        assert error == pytest.approx(image, rel=0.25)


def test_modules_that_turn_a_parcel_drag_its_front_one_way_and_its_rear_the_other() -> None:
    starts = [{"parcel": parcel, "speed": 1.5, "angle": 0.3} for parcel in "SB"]
    env, observations = begun("orient", starts)
    for _ in range(15):
        observations, *_ = env.step(np.full((2, 64), ROLL))
    sight = look_at_line(env.config)
    axes, scratch = np.array([ROLL, 0, MINUS_45, PLUS_45]), steering.make_modules(64)
    for observation in observations:
        seen = see_line(observation, sight)
        place_modules(seen, sight, scratch)
        x, ways = scratch.x, []
        for option in range(1 + steering.KINDS_OF_TURN * len(steering.FROM)):
            choose_turn(option, seen, axes, scratch)
            ways.append(scratch.choice.copy())
        turned = [(set(way[x > 0]) - {ROLL}, set(way[x < 0]) - {ROLL}) for way in ways]
        assert turned[0] == (set(), set())
        assert all(len(front) <= 1 >= len(rear) for front, rear in turned)
        assert not any(front & rear for front, rear in turned)
        assert any(front and rear for front, rear in turned)


def test_the_turning_rule_turns_to_any_angle() -> None:
    assert run_rule("orient", "turning rule", TURNS).success.all()
    assert not run_rule("orient", "fixed layout", TURNS).success.all()
    small = [turn for turn in TURNS if turn["parcel"] == "S"]
    for name in ("threshold logic", "PID per module"):
        assert run_rule("orient", name, small).success.mean() >= 0.75


def test_a_fixed_turn_is_the_best_of_its_kind() -> None:
    """No other number of columns leaves nearer to the asked angle, in the environment itself."""
    start, config = {"parcel": "S", "speed": 1.5, "angle": 0.3}, EnvConfig("orient")
    layouts = FixedTurning(config)._layouts
    others = run(Scripted(layouts[:, np.newaxis]), config, [start] * len(layouts))
    errors = [each.metrics["angle_error"] for each in (others, run_rule("orient", FIXED, [start]))]
    assert np.abs(errors[1]).item() == pytest.approx(np.abs(errors[0]).min(), abs=0.01)


def test_positions_are_the_modules_that_the_environment_sees_under_the_parcel() -> None:
    env, seen = begun("track", [{}] * 20, seed=5, actions="window")
    rng = np.random.default_rng(0)
    for _ in range(10):
        sight, scratch = look_at_path(env.config), steering.make_modules(25)
        for observation in seen:
            place_modules(see_path(observation, sight), sight, scratch)
            np.testing.assert_array_equal(scratch.braking > 0.0, observation[-25:] > 0.5)
        seen, *_ = env.step(rng.integers(0, 4, (20, 25)))
    env, seen = begun("orient", [{"parcel": "S"}, {"parcel": "B"}])
    sight = look_at_line(env.config)
    modules = [steering.make_modules(64) for _ in "SB"]
    for observation, scratch in zip(seen, modules, strict=True):
        place_modules(see_line(observation, sight), sight, scratch)
    # The S-box's lead-in is 3 columns and the B-box's 5; the first rotor after it is at 0.35 m, a
    # box's rear at x = 0.
    first = np.array([0.35, 0.55]) - [0.125, 0.225]
    found = [scratch.x.reshape(4, 16)[2, 0] for scratch in modules]
    np.testing.assert_allclose(found, first, atol=1e-6)
    across = [scratch.y.reshape(4, 16)[:, 3] for scratch in modules]
    np.testing.assert_allclose(across, [[-0.15, -0.05, 0.05, 0.15]] * 2, atol=1e-6)


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
@pytest.mark.parametrize("angle", [0.0, math.pi / 4, -math.pi / 4, math.pi / 2])
def test_the_square_slides_as_in_the_simulator(angle) -> None:
    """All axes alike under a box on a field, tilted by 0.1: 40 ms of it."""
    velocity, tilt = (0.8, 0.3, 0.5), 0.1
    surface = sg.Surface(np.full((20, 20), angle), np.ones((20, 20), dtype=bool), tilt=tilt)
    box = sg.layouts.box("S")
    truth = sg.simulate(surface, box, (1.0, 1.0, 0.0), velocity, duration=0.04).velocity[-1]
    start = {"parcel": "S", "path": [(1.0, 1.0), (5.0, 1.0)], "tilt": tilt, "speed": 0.8}
    env, seen = begun("track", [start], actions="window")
    sight, scratch = look_at_path(env.config), steering.make_modules(25)
    place_modules(see_path(seen[0], sight), sight, scratch)
    directions, pull = np.array([[math.cos(angle), math.sin(angle)]]), GRAVITY * math.sin(tilt)
    found = predict(scratch, directions, Motion(*velocity), 0.125, pull, 0.04)
    assert (np.abs(np.array(found) - truth) <= [0.03, 0.03, 0.5]).all()


CREEPING = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)
SORTING = SteeredRoller(speeds=(1.0, 2.0))


def test_it_sorts_every_parcel_also_from_rest():
    config = EnvConfig("sort", actions="halves", modules=SORTING)
    starts = [{"speed": speed, "side": side} for speed in (0.0, 0.4, 2.5) for side in (1, -1)]
    assert run_episodes(AimRule(config), config, starts, 0).success.all()


# Each of these compiles a kernel.
@pytest.mark.parametrize(
    ("task", "modules", "least"),
    [
        ("stop", Belt(speeds=CREEPING), 1.0),
        ("slow", Belt(speeds=tuple(np.arange(0.0, 2.7, 0.02)), idle_outside=True), 0.7),
        ("orient", OmniModule(speeds=(0.0, 0.5, 1.0)), 0.9),
        ("track", OmniModule(speeds=(0.2, 0.4, 0.6, 0.8, 1.0, 1.2)), 1.0),
    ],
)
def test_it_serves_every_task(task, modules, least):
    assert AIMS[task].kinds
    config = EnvConfig(task, actions="halves", modules=modules)
    episodes = run_episodes(AimRule(config), config, [{}] * 24, 5)
    assert episodes.success.mean() >= least


def test_the_wanted_speed_near_a_place_can_be_braked():
    distance = np.array([-1.0, -0.001, 0.0, 0.001, 1.0])
    speed = towards(distance)
    np.testing.assert_allclose(speed, -speed[::-1])
    assert (speed**2 / (2.0 * 0.5 * 9.81) <= np.abs(distance) + 1e-12).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"task": "sort"}, "modules must be"),
        ({"task": "sort", "modules": "omni", "actions": "modules"}, "actions must be"),
        ({"task": "flow", "modules": "omni", "actions": "parcels"}, "task must be"),
    ],
)
def test_it_refuses_what_it_does_not_serve(arguments, message):
    with pytest.raises(ValueError, match=message):
        AimRule(EnvConfig(**{"actions": "halves", **arguments}))
