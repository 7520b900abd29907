"""What a parcel brings to a lane, and how it is put there."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.batch.placement import NO_EDGE, placement_of
from surface_gym.lanes.memory import COM_X, COM_Y, HALF_LENGTH, RADIUS
from surface_gym.plant import PITCH, Field, Line
from surface_gym.settings import Settings
from surface_gym.tasks.task import Start
from tests.environments import HEPTAGON, PARCELS, TRIANGLE

every_parcel = pytest.mark.parametrize("parcel", PARCELS.values(), ids=PARCELS)
FIRST = np.zeros(1, dtype=np.int64)


def under(parcel: sg.Parcel, x: float, y: float, theta: float) -> int:
    """How many points of an endless grid lie under a base, its centroid at (x, y)."""
    places = PITCH * np.arange(-15, 16)
    dx, dy = np.meshgrid(places - x, places - y)
    cosine, sine = math.cos(theta), math.sin(theta)
    centre_x, centre_y = parcel.base.centroid
    functions = parcel.base.functions(
        centre_x + cosine * dx + sine * dy, centre_y + cosine * dy - sine * dx
    )
    return int((functions <= 0.0).all(axis=0).sum())


@every_parcel
def test_there_is_room_for_all_contacts(parcel: sg.Parcel) -> None:
    rng = np.random.default_rng(0)
    most = max(
        under(parcel, *rng.uniform(-0.1, 0.1, 2), rng.uniform(-math.pi, math.pi))
        for _ in range(500)
    )
    assert 0 < most <= placement_of(parcel, Line(), None).contacts


@every_parcel
def test_corners_and_edges_are_the_bases(parcel: sg.Parcel) -> None:
    placement = placement_of(parcel, Line(), None)
    np.testing.assert_array_equal(placement.edges, parcel.base.edges)
    corners = placement.corners + parcel.base.centroid
    if isinstance(parcel.base, sg.Disc):
        np.testing.assert_array_equal(placement.corners, [[0.0, 0.0]])
    else:
        np.testing.assert_allclose(corners, parcel.base.outline, atol=1e-15)
    assert placement.body[RADIUS] == parcel.base.reach
    assert placement.body[[COM_X, COM_Y]].tolist() == list(parcel.com_offset)
    rear = parcel.base.outline[:, 0].min() - parcel.base.centroid[0]
    assert placement.body[HALF_LENGTH] == pytest.approx(-rear)


@every_parcel
def test_only_rotors_of_the_zone_obey(parcel: sg.Parcel) -> None:
    placement = placement_of(parcel, Line(), (7, 9))
    rows, columns = np.nonzero(placement.obeys)
    assert set(columns.tolist()) == {7, 8, 9}
    assert placement.rotor[rows, columns].all()
    everywhere = placement_of(parcel, Field(8, 10), None)
    assert everywhere.obeys.all()


@every_parcel
@pytest.mark.parametrize("velocity", [(1.0, 0.0, 0.0), (0.5, -0.3, 4.0)])
def test_a_lane_tells_the_pose_it_was_given(
    parcel: sg.Parcel, velocity: tuple[float, float, float]
) -> None:
    """The state is the centre of mass's; what is told is of the centroid, as a rigid body moves."""
    pose = (0.7, 1.05, 0.6)
    batch = Settings().make_batch(1)
    batch.place(0, Start(parcel, pose, velocity, (1.0,)), np.random.default_rng(0))
    batch.begin(FIRST)
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    x, y = parcel.base.centroid
    arm = np.array([cosine * x - sine * y, sine * x + cosine * y])
    vx, vy, omega = velocity
    wanted = [*(arm + pose[:2]), pose[2], vx - omega * arm[1], vy + omega * arm[0], omega]
    np.testing.assert_allclose(batch.lanes.truth[0], wanted, rtol=0, atol=1e-14)


def test_a_lane_forgets_the_parcel_before() -> None:
    start = Start(sg.layouts.box("S"), (0.125, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,))
    used, fresh = Settings().make_batch(1), Settings().make_batch(1)
    for parcel in (HEPTAGON, sg.layouts.box("B"), TRIANGLE):
        used.place(0, start._replace(parcel=parcel), np.random.default_rng(0))
        used.begin(FIRST)
        used.advance(np.full((1, 64), 1))
    for batch in (used, fresh):
        batch.place(0, start, np.random.default_rng(0))
        batch.begin(FIRST)
    for name, found, wanted in zip(used.lanes._fields, used.lanes, fresh.lanes, strict=True):
        if name in ("edges", "corners"):  # the heptagon's seven leave room behind the box's four
            np.testing.assert_array_equal(found[0, :4], wanted[0])
        elif name not in ("command", "memory"):
            np.testing.assert_array_equal(found, wanted, name)
    np.testing.assert_array_equal(used.lanes.edges[0, 4:], [NO_EDGE] * 3)
    assert (used.lanes.corners[0, 4:] == used.lanes.corners[0, 0]).all()


def test_parcels_that_do_not_fit_are_told_beforehand() -> None:
    batch = Settings().make_batch(1)
    batch.check(sg.layouts.box("B"))
    with pytest.raises(ValueError, match="parcel must be at most"):
        batch.check(sg.Parcel(sg.Rectangle(3.0, 0.1)))
