"""What a parcel brings to an environment, and how it is put there."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.core.resets import NO_EDGE, place_parcel
from surface_gym.lines import Field, Line
from surface_gym.physics.types import COM_X, COM_Y, HALF_LENGTH, RADIUS
from surface_gym.tasks.start import Start
from tests.environments import HEPTAGON, PARCELS, TRIANGLE, batch_with, put

every_parcel = pytest.mark.parametrize("parcel", PARCELS.values(), ids=PARCELS)


@every_parcel
def test_corners_and_edges_are_the_bases(parcel: sg.Parcel) -> None:
    placement = place_parcel(parcel, Line(), None)
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
    placement = place_parcel(parcel, Line(), (7, 9))
    rows, columns = np.nonzero(placement.obeys)
    assert set(columns.tolist()) == {7, 8, 9}
    assert placement.rotor[rows, columns].all()
    everywhere = place_parcel(parcel, Field(8, 10), None)
    assert everywhere.obeys.all()


@every_parcel
@pytest.mark.parametrize("velocity", [(1.0, 0.0, 0.0), (0.5, -0.3, 4.0)])
def test_a_start_gives_its_pose(parcel: sg.Parcel, velocity: tuple[float, float, float]) -> None:
    """The state is the centre of mass's; the pose reported is the centroid's, as a body moves."""
    pose = (0.7, 1.05, 0.6)
    batch = batch_with(Start(parcel, pose, velocity, (1.0,)))
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    x, y = parcel.base.centroid
    arm = np.array([cosine * x - sine * y, sine * x + cosine * y])
    vx, vy, omega = velocity
    wanted = [*(arm + pose[:2]), pose[2], vx - omega * arm[1], vy + omega * arm[0], omega]
    np.testing.assert_allclose(batch.parcels.truth[0], wanted, rtol=0, atol=1e-14)


def test_a_start_forgets_the_parcel_before() -> None:
    start = Start(sg.layouts.box("S"), (0.125, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,))
    used, fresh = Batch(EnvConfig(), 1), batch_with(start)
    for parcel in (HEPTAGON, sg.layouts.box("B"), TRIANGLE):
        put(used, start._replace(parcel=parcel))
        used.step(np.full((1, 64), 1))
    put(used, start)
    view = used.view(0)
    for name, found, wanted in zip(view._fields, view, fresh.view(0), strict=True):
        if name in ("edges", "corners"):  # the heptagon's seven leave room behind the box's four
            np.testing.assert_array_equal(found[:4], wanted)
        elif name != "memory":
            np.testing.assert_array_equal(found, wanted, name)
    np.testing.assert_array_equal(view.edges[4:], [NO_EDGE] * 3)
    assert (view.corners[4:] == view.corners[0]).all()


def test_equal_parcels_share_a_row_of_the_body_table() -> None:
    batch = Batch(EnvConfig(), 5)
    mine = sg.Parcel(sg.Disc(0.12))
    boxes = [sg.layouts.box(size) for size in "SBSB"]  # equal, not the same
    for i, parcel in enumerate([*boxes, mine]):
        put(batch, Start(parcel, (parcel.rear, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,)), i)
    assert batch.parcels.body[:4].tolist() == [0, 1, 0, 1]
    assert [batch.view(i).body[RADIUS] for i in (0, 4)] == [sg.layouts.box("S").base.reach, 0.12]
