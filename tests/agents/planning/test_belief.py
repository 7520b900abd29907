"""The planner on beliefs: what it reads from observations, its model, and that it sees no more."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import Parcel, Polygon, Rectangle
from surface_gym.agents.planning.belief import BeliefDecoder, BeliefModel, BeliefPlanner, vary
from surface_gym.agents.planning.models import FIRST
from surface_gym.config import EnvConfig
from surface_gym.parcel import Base
from surface_gym.physics.types import AX, AY
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import AdaptiveCamera
from surface_gym.tasks import Stop
from tests.agents.rules.runs import run

SPEED = 0.5 * math.pi / 0.05  # [rad/s] an axis turns by 90 deg in 50 ms
KITE = Polygon(np.array([[-0.1, 0.0], [0.0, -0.12], [0.2, 0.0], [0.0, 0.1]]))
BOX = Rectangle(0.25, 0.2)
START = {"speed": 1.1, "position": 1.4}
SMALL = 8  # width of a beam that finds something soon


def config(base: Base, load: float = 0.0, stuck_share: float = 0.0, **more: Any) -> EnvConfig:
    return EnvConfig(
        Stop(parcels=(Parcel(base, com_offset=(load, -load)),)), actions="halves",
        actuators=Actuators(axis_speed=SPEED, stuck_share=stuck_share), **more,
    )  # fmt: skip


@pytest.mark.parametrize("base", [BOX, KITE])
def test_its_model_goes_on_like_the_environment(base) -> None:
    """From the pose that it reads, with the axes where commands turned them.

    Accelerations, which it does not read, are copied: they move the weight.
    """
    own = config(base)
    env, model, decoder = (
        sg.SmartSurfaceEnv(**own.arguments()),
        BeliefModel(own, 2),
        BeliefDecoder(own),
    )
    observation, _ = env.reset(seed=0, options=START)
    angles = None
    for action in np.random.default_rng(3).integers(16, size=8):
        belief = decoder.decode(observation)
        moved = env.batch.parcels.truth[0]
        np.testing.assert_allclose([*belief.start.pose, *belief.start.velocity], moved, atol=1e-5)
        assert belief.start.goal[0] == pytest.approx(1.4, abs=1e-6)
        model.begin_from(belief._replace(friction=1.0), angles)
        model.parcels.state[0, AX : AY + 1] = env.batch.parcels.state[0, AX : AY + 1]
        model.spread()
        expected = model.advance(FIRST, np.array([action])).parcels.truth[0].copy()
        angles = model.angles
        observation, *_ = env.step(int(action))
        np.testing.assert_allclose(expected, moved, atol=1e-5)
    np.testing.assert_allclose(angles, env.batch.surfaces.angle[0])


def test_it_reads_outline_friction_and_load() -> None:
    sensor = AdaptiveCamera(friction_spread=0.1, load_spread=0.02)
    own = config(KITE, sensors=sensor, observe=("parcel", "load"))
    own = own.replace(task=Stop(parcels=(Parcel(BOX), Parcel(KITE, com_offset=(0.03, 0.0)))))
    places = {feature.name: k for k, feature in enumerate(own.features)}
    seen = np.zeros(len(own.features), dtype=np.float32)
    for name, value in (("size", -0.5), ("length", -0.5), ("width", -1.3), ("fill", 0.5)):
        seen[places[name]] = value
    seen[places["cosine of theta"]] = 1.0
    plain = BeliefDecoder(own).decode(seen)
    assert plain.start.parcel.com_offset == (0.0, 0.0)  # not the task's parcel's
    np.testing.assert_allclose(plain.start.parcel.base.outline, KITE.outline - KITE.centroid)
    for name, value in (
        ("friction learned", 2.0),
        ("load learned, x", 1.0),
        ("load learned, y", -0.5),
    ):
        seen[places[name]] = value
    learned = BeliefDecoder(own).decode(seen)
    assert learned.start.parcel.com_offset == pytest.approx((0.02, -0.01))
    assert learned.friction / plain.friction == pytest.approx(1.2)
    seen[places["doubt of friction"]] = 1.0
    assert BeliefDecoder(own).decode(seen).friction < learned.friction


def test_what_is_hidden_changes_nothing() -> None:
    """On equal observations, loads, stuck modules and friction change no action."""
    hidden = Randomisation(friction=0.15, rolling=0.15, com_offset=0.1)
    worlds = config(BOX), config(BOX, 0.03, 0.1, randomisation=hidden)
    env = sg.SmartSurfaceEnv(**worlds[0].arguments())
    planners = [BeliefPlanner(world, SMALL) for world in worlds]
    observation, _ = env.reset(seed=0, options=START)
    states: list[Any] = [None, None]
    for _ in range(6):
        actions = []
        for k, planner in enumerate(planners):
            action, states[k] = planner.predict(observation, states[k])
            actions.append(int(action))
        assert actions[0] == actions[1]
        observation, *_ = env.step(actions[0])


def test_it_stops() -> None:
    own = config(BOX)
    assert run(BeliefPlanner(own, SMALL), own, [START]).success.all()
    with pytest.raises(ValueError, match="budget must be a whole number of at least 1"):
        BeliefPlanner(own, 0)


def test_variations_keep_the_actions_before() -> None:
    plans = np.arange(12)[np.newaxis].repeat(200, axis=0)
    varied = vary(plans, 16, np.random.default_rng(0))
    assert (varied.shape, varied.min() >= 0, varied.max() < 16) == (plans.shape, True, True)
    changed = varied != plans
    first = np.where(changed.any(axis=1), changed.argmax(axis=1), 12)
    assert len(np.unique(first)) > 8
    assert changed.any(axis=1).mean() > 0.9
