"""Models of searches against the environments they copy, and what braking will do, against both."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import Disc, Parcel, Rectangle
from surface_gym.agents.planning import models
from surface_gym.agents.planning.models import TrueModel
from surface_gym.config import EnvConfig
from surface_gym.layouts import ROLLING
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.tasks import TASKS, Stop

FAR = 100.0  # [m] beyond any line
EITHER_WAY = 6  # the action of 45 deg ahead and -45 deg behind


def model_of(parcel: Parcel, quarter: float | None = None, friction: float = 0.0) -> TrueModel:
    config = EnvConfig(
        task=Stop(parcels=(parcel,)), actions="halves",
        actuators=Actuators() if quarter is None else Actuators(axis_speed=0.5 * math.pi / quarter),
        randomisation=Randomisation(friction=friction),
    )  # fmt: skip
    model = TrueModel(config, 2)
    model.begin({"speed": 1.5}, seed=4)
    model.parcels.goal[0] = FAR
    model.spread()
    return model


def rolled_in(model: TrueModel) -> models.SearchNodes:
    for _ in range(10):
        nodes = model.step(model.uniform_action(ROLLING))
    return nodes


@pytest.mark.parametrize("side", [0.25, 0.5])
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_braking_ends_where_it_is_predicted(side, friction) -> None:
    """Of a parcel that lies over supports too, and with friction as it was drawn; to a hundredth of
    the way and the centimetre that whole columns make.
    """
    model = model_of(Parcel(Rectangle(side, side)), friction=friction)
    nodes = rolled_in(model)
    stops = float(nodes.parcels.truth[0, 0] + nodes.braking_distance[0])
    way = float(nodes.braking_distance[0])
    for _ in range(30):
        nodes = model.step(model.uniform_action(0.0))
    assert abs(nodes.parcels.truth[0, 3]) < 1e-3
    assert nodes.parcels.truth[0, 0] == pytest.approx(stops, rel=0.0, abs=max(0.01 * way, 0.015))


@pytest.mark.parametrize("quarter", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("speed", [0.05, 0.3, 1.5])
def test_axes_that_turn_brake_later(quarter, speed) -> None:
    """As far as steps of 10 us come: a third of the load on axes at 90 deg, the rest at -30 deg."""
    braking, turned = 4.0, 0.5 * math.pi / quarter
    places = np.linspace(0.0, 5.0, 1001)
    profile = models.BrakingProfile(places, np.full(1001, braking), braking * places)
    angle, zero = np.array([[0.5 * math.pi, -math.pi / 6.0]]), np.zeros((1, 2))
    turning = models.TurningAxes(angle, zero, zero, np.array([[1.0, 2.0]]) / 3.0, turned, 0.01)
    way, left, step, clock = 0.0, speed, 1e-5, 0.0
    while left > 0.0:
        axes = np.maximum(0.0, np.abs(angle[0]) - turned * clock)
        left -= step * braking * (np.cos(axes) @ [1.0, 2.0]) / 3.0
        way, clock = way + step * max(0.0, left), clock + step
    said = turning.braking_distance(np.zeros(1), np.array([speed]), profile)
    np.testing.assert_allclose(said, way, rtol=0.02, atol=3e-4)


def test_what_axes_take_until_they_roll() -> None:
    model = model_of(Parcel(Rectangle(0.3, 0.3)), quarter=0.2)
    rolled_in(model)
    nodes = model.step(EITHER_WAY)
    before, left = float(nodes.parcels.truth[0, 3]), float(nodes.vx[0])
    for _ in range(2):
        nodes = model.step(model.uniform_action(ROLLING))
    rolling = nodes.rolling_loss * 2 * 0.04
    assert before - left > 0.02
    assert left - rolling == pytest.approx(nodes.parcels.truth[0, 3], abs=0.3 * (before - left))


def test_axes_push_to_the_side_they_turn_to_and_turn_the_parcel_where_halves_differ() -> None:
    changes = {}
    for action in (5, 10, 6, 9):  # 45 deg, -45 deg, and each half the other way
        model = model_of(Parcel(Rectangle(0.4, 0.4)), quarter=0.2)
        rolled_in(model)
        nodes = model.step(action)
        changes[action] = nodes.turning.velocity_changes(nodes.braking)[0]
        # What axes have done so far goes on.
        assert np.sign(changes[action][1]) == np.sign(nodes.parcels.truth[0, 4])
    np.testing.assert_allclose(changes[5] * [1.0, -1.0, -1.0], changes[10], atol=1e-3)
    assert changes[5][1] < -0.05
    assert abs(changes[6][2] - changes[9][2]) > 2.0 * abs(changes[5][2])


@pytest.mark.parametrize("base", [Rectangle(0.4, 0.22), Disc(0.15)], ids=["rectangle", "disc"])
def test_a_base_is_where_its_outline_and_its_functions_say(base) -> None:
    model = model_of(Parcel(base), quarter=0.2)
    nodes = rolled_in(model)
    np.testing.assert_allclose(nodes.vx, nodes.parcels.truth[:, 3], atol=1e-12)  # axes roll
    centre, body = np.array(base.centroid), int(model.parcels.body[0])
    x, y = np.meshgrid(np.linspace(-0.29, 0.3, 41), np.linspace(-0.29, 0.3, 41))
    inside = base.functions(x + centre[0], y + centre[1]).max(axis=0) <= 0.0
    np.testing.assert_array_equal(models.is_under(model._batch.bodies, body, x, y), inside)
    nodes.parcels.truth[:, 2] = 0.7
    cosine, sine = math.cos(0.7), math.sin(0.7)
    turned = (base.outline - centre) @ np.array([[cosine, sine], [-sine, cosine]])
    for way in ((-1.0, 0.0), (0.0, 1.0), (0.6, -0.8)):
        assert nodes.reach(*way)[0] == pytest.approx((turned @ way).max(), abs=5e-4)


SEED = 31
SLOW_AXES = Actuators(axis_speed=0.5 * math.pi / 0.1, stuck=((9, 8), (10, 11)))


def begun(config: EnvConfig, size: int = 4) -> TrueModel:
    model = TrueModel(config, size)
    model.begin({}, SEED)
    return model


@pytest.mark.parametrize("task", TASKS)
def test_in_a_lab_it_is_the_start_of_the_environment_with_all_its_noise(task) -> None:
    model = begun(EnvConfig(task=task, actions="halves", preset="lab"))
    env = sg.SmartSurfaceVectorEnv(3, task=task, actions="halves", preset="lab")
    for i in range(3):
        model.begin({}, SEED + i)
        _, info = env.reset(seed=SEED)
        np.testing.assert_array_equal(model.parcels.truth[0, :3], info["pose"][i])
        np.testing.assert_array_equal(model.parcels.truth[0, 3:], info["velocity"][i])


@pytest.mark.parametrize("task", ["sort", "slow", "track"])
def test_whatever_the_sensors_say_it_moves_as_the_environment_does(task) -> None:
    """Where both halves get the same command, their border does not matter: parcel, friction,
    stuck modules and axes are the environment's.
    """
    settings: dict[str, Any] = {"task": task, "actions": "halves", "preset": "lab"}
    model, env = begun(EnvConfig(**settings)), sg.SmartSurfaceEnv(**settings)
    env.reset(seed=SEED)
    for angle in (0.5, 0.25, -0.25, 0.5, 0.0, -0.25):
        action = model.uniform_action(math.pi * angle)
        model.step(action)
        *_, info = env.step(action)
        np.testing.assert_array_equal(model.parcels.truth[0, :3], info["pose"])
        np.testing.assert_array_equal(model.parcels.truth[0, 3:], info["velocity"])


def test_copies_take_their_parents_axes_with_them() -> None:
    config = EnvConfig(task="slow", actions="halves", actuators=SLOW_AXES)
    ways = np.array([[15, 6, 2, 15, 9, 9], [15, 6, 13, 1, 9, 4], [15, 3, 7, 8, 4, 2]])
    model = begun(config)
    place = np.zeros(3, dtype=np.int64)  # of the copy that goes each way
    orders = [[0, 1, 2], [2, 0, 1], [1, 2, 0], [2, 1, 0], [1, 0, 2], [0, 2, 1]]
    for period, order in enumerate(orders):
        parents, actions = np.empty((2, 3), dtype=np.int64)
        parents[order], actions[order] = place, ways[:, period]
        nodes = model.advance(parents, actions)
        place = np.array(order)
    for way in range(3):
        env = sg.SmartSurfaceEnv(task="slow", actions="halves", actuators=SLOW_AXES)
        env.reset(seed=SEED)
        for action in ways[way].tolist():
            *_, info = env.step(action)
        np.testing.assert_array_equal(nodes.parcels.truth[place[way], :3], info["pose"])


def test_rewound_it_goes_the_same_way_again() -> None:
    model = begun(EnvConfig(task="slow", actions="halves", preset="lab"))
    model.step(6)
    ends, first = [], np.zeros(1, dtype=np.int64)
    for _ in range(2):
        model.rewind()
        for action in (9, 2):
            nodes = model.advance(first, np.array([action]))
        ends.append(nodes.parcels.truth[0].copy())
    np.testing.assert_array_equal(*ends)


def test_another_start_forgets_what_was_stuck_before() -> None:
    config = EnvConfig(task="slow", actions="halves", actuators=Actuators(stuck_share=0.2))
    used, fresh = TrueModel(config, 3), TrueModel(config, 3)
    for seed in (1, 2):
        used.begin({}, seed)
        for action in (0, 5):
            used.step(action)
    fresh.begin({}, 7)
    used.begin({}, 7)
    for action in (0, 5, 10, 0, 3, 12, 0, 0, 15, 6):
        both = [model.step(action) for model in (used, fresh)]
    np.testing.assert_array_equal(both[0].parcels.truth, both[1].parcels.truth)
