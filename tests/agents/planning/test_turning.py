"""What axes on their way will do, and how far braking goes, against the simulator itself."""

import math

import numpy as np
import pytest

from agents.planning.grip import Grip, is_under
from agents.planning.known import KnownModel
from agents.planning.stand import Stand
from agents.planning.turning import Turning
from surface_gym import Disc, Parcel, Rectangle
from surface_gym.layouts import ROLLING
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.settings import Settings
from surface_gym.tasks import Stop

FAR = 100.0  # [m] beyond any line
EITHER_WAY = 6  # the action of 45 deg ahead and -45 deg behind


def model_of(parcel: Parcel, quarter: float | None = None, friction: float = 0.0) -> KnownModel:
    """A parcel that enters at 1.5 m/s; a quarter turn of its axes takes so long [s]."""
    actuators = Actuators() if quarter is None else Actuators(axis_speed=0.5 * math.pi / quarter)
    settings = Settings(
        task=Stop(parcels=(parcel,)),
        actions="halves",
        actuators=actuators,
        randomisation=Randomisation(friction=friction),
    )
    model = KnownModel(settings, 2)
    model.begin({"speed": 1.5}, seed=4)
    model.parcels.goal[0] = FAR
    return model


def rolled_in(model: KnownModel) -> Stand:
    """Once the parcel is wholly in the zone."""
    for _ in range(10):
        stand = model.go_on(model.uniform_action(ROLLING))
    return stand


@pytest.mark.parametrize("side", [0.25, 0.5])
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_braking_ends_where_it_is_said_to(side: float, friction: float) -> None:
    """Of a parcel that lies over supports too, and with friction as it was drawn; to a hundredth of
    the way and the centimetre that whole columns make.
    """
    model = model_of(Parcel(Rectangle(side, side)), friction=friction)
    stand = rolled_in(model)
    way, x = float(stand.braking_way[0]), float(stand.parcels.truth[0, 0])
    for _ in range(30):
        stand = model.go_on(model.uniform_action(0.0))
    assert abs(stand.parcels.truth[0, 3]) < 1e-3
    assert way == pytest.approx(stand.parcels.truth[0, 0] - x, rel=0.01, abs=0.015)


def test_wide_parcels_are_braked_less() -> None:
    wide, narrow = (rolled_in(model_of(Parcel(Rectangle(0.5, width)))) for width in (0.5, 0.2))
    assert wide.braking_way[0] > 1.1 * narrow.braking_way[0]


@pytest.mark.parametrize("quarter", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("speed", [0.05, 0.3, 1.5])
def test_axes_that_turn_brake_later(quarter: float, speed: float) -> None:
    """As far as steps of 10 us come: a third of the load on axes at 90 deg, the rest at -30 deg."""
    braking, turned = 4.0, 0.5 * math.pi / quarter
    places = np.linspace(0.0, 5.0, 1001)
    grip = Grip(places, np.full(1001, braking), braking * places)
    angle, zero = np.array([[0.5 * math.pi, -math.pi / 6.0]]), np.zeros((1, 2))
    turning = Turning(angle, zero, zero, np.array([[1.0, 2.0]]) / 3.0, turned, 0.01)
    way, left, step, clock = 0.0, speed, 1e-5, 0.0
    while left > 0.0:
        axes = np.maximum(0.0, np.abs(angle[0]) - turned * clock)
        left -= step * braking * (np.cos(axes) @ [1.0, 2.0]) / 3.0
        way, clock = way + step * max(0.0, left), clock + step
    said = turning.braking_way(np.zeros(1), np.array([speed]), grip)
    np.testing.assert_allclose(said, way, rtol=0.02, atol=3e-4)


def test_what_axes_take_until_they_roll() -> None:
    """Turned a little to either side, and back."""
    model = model_of(Parcel(Rectangle(0.3, 0.3)), quarter=0.2)
    rolled_in(model)
    stand = model.go_on(EITHER_WAY)
    before, left = float(stand.parcels.truth[0, 3]), float(stand.vx[0])
    for _ in range(2):
        stand = model.go_on(model.uniform_action(ROLLING))
    rolling = stand.rolling_loss * 2 * 0.04
    assert before - left > 0.02
    assert left - rolling == pytest.approx(stand.parcels.truth[0, 3], abs=0.3 * (before - left))


def test_axes_push_to_the_side_they_turn_to_and_turn_the_parcel_where_halves_differ() -> None:
    pushes = {}
    for action in (5, 10, 6, 9):  # 45 deg, -45 deg, and each half the other way
        model = model_of(Parcel(Rectangle(0.4, 0.4)), quarter=0.2)
        rolled_in(model)
        stand = model.go_on(action)
        assert stand.turning is not None
        pushes[action] = stand.turning.pushes(stand.braking)[0]
        # What axes have done so far goes on.
        assert np.sign(pushes[action][1]) == np.sign(stand.parcels.truth[0, 4])
    np.testing.assert_allclose(pushes[5] * [1.0, -1.0, -1.0], pushes[10], atol=1e-3)
    assert pushes[5][1] < -0.05
    assert abs(pushes[6][2] - pushes[9][2]) > 2.0 * abs(pushes[5][2])


def test_axes_that_roll_take_nothing() -> None:
    stand = rolled_in(model_of(Parcel(Rectangle(0.3, 0.3)), quarter=0.2))
    np.testing.assert_allclose(stand.vx, stand.parcels.truth[:, 3], atol=1e-12)


@pytest.mark.parametrize(("x", "y"), [(-1.0, 0.0), (0.0, 1.0), (0.6, -0.8)])
def test_bases_reach_as_far_as_their_outline(x: float, y: float) -> None:
    for base in (Rectangle(0.4, 0.22), Disc(0.15)):
        stand = rolled_in(model_of(Parcel(base)))
        stand.parcels.truth[:, 2] = 0.7
        outline = base.outline - np.array(base.centroid)
        cosine, sine = math.cos(0.7), math.sin(0.7)
        turned = outline @ np.array([[cosine, sine], [-sine, cosine]])
        assert stand.reach(x, y)[0] == pytest.approx((turned @ [x, y]).max(), abs=5e-4)


def test_points_are_under_a_base_where_its_functions_say_so() -> None:
    for base in (Rectangle(0.4, 0.22), Disc(0.15)):
        model = model_of(Parcel(base))
        x, y = np.meshgrid(np.linspace(-0.29, 0.3, 41), np.linspace(-0.29, 0.3, 41))
        centre = np.array(base.centroid)
        inside = base.functions(x + centre[0], y + centre[1]).max(axis=0) <= 0.0
        sites, site = model._batch.bodies, int(model.parcels.site[0])
        np.testing.assert_array_equal(is_under(sites, site, x, y), inside)
