"""From a lane to the scene that is drawn."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.core.batch import Batch
from surface_gym.picture import scene_of
from surface_gym.rendering import Scene
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS
from surface_gym.tasks.base import Start
from tests.batches import batch_with, put
from tests.environments import HEPTAGON, PARCELS, PLUS_45

TRAIL = np.array([[0.1, 1.0], [0.2, 1.0]])


def batch_of(parcel: sg.Parcel, task: str = "sort", **settings: Any) -> Batch:
    batch = Batch(Settings(task=task, **settings), 2)
    for lane in (0, 1):
        batch.reserve.seed(lane, np.random.default_rng(lane))
    batch.start(np.arange(2), [{"speed": 1.0, "parcel": parcel}] * 2)
    return batch


def shown(batch: Batch, lane: int = 0) -> Scene:
    return scene_of(batch, lane, TRAIL)


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_a_scene_with_its_goal(task: str) -> None:
    scene = shown(batch_of(PARCELS["S"], task))
    assert scene.title == task.capitalize()
    assert scene.goal is not None
    labels = [label for label, _ in scene.readings]
    assert labels[:3] == ["time", "speed", "heading"]
    assert len(labels) > 3
    assert len(set(labels)) == len(labels)


@pytest.mark.parametrize("parcel", PARCELS.values(), ids=PARCELS)
def test_the_outline_is_the_bases(parcel: sg.Parcel) -> None:
    batch = batch_of(parcel)
    put(batch, Start(HEPTAGON, (0.2, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,)), lane=1)
    outline = shown(batch).outline
    if isinstance(parcel.base, sg.Disc):
        np.testing.assert_allclose(np.hypot(*outline.T), parcel.base.radius)
    else:
        np.testing.assert_allclose(outline + parcel.base.centroid, parcel.base.outline, atol=1e-15)


def test_axes_zone_and_pose_are_the_lanes() -> None:
    batch = batch_of(PARCELS["S"])
    for _ in range(3):
        batch.advance(np.full((2, 64), PLUS_45))
    for lane in (0, 1):
        scene = shown(batch, lane)
        assert scene.pose == tuple(batch.parcels.truth[lane, :3])
        first_row, rows, first_column, columns = scene.zone
        zone = np.zeros(scene.axis.shape, dtype=bool)
        zone[first_row : first_row + rows, first_column : first_column + columns] = True
        np.testing.assert_allclose(scene.axis, np.where(zone, math.pi / 4, math.pi / 2))
        np.testing.assert_array_equal(scene.rotor, batch.view(lane).rotor)
    assert dict(scene.readings)["time"] == "0.12 s"


def test_a_sensed_pose_is_shown_where_it_is_another() -> None:
    batch = batch_of(PARCELS["S"])
    assert shown(batch).sensed_pose is None
    batch.parcels.sensed[0, 1] += 0.02
    sensed = shown(batch).sensed_pose
    assert sensed is not None
    assert sensed[1] == pytest.approx(1.02)


def test_an_end_is_told() -> None:
    batch = batch_of(PARCELS["S"])
    assert "end" not in dict(shown(batch).readings)
    while batch.parcels.outcome[0] == 0:
        batch.advance(np.full((2, 64), 0))
    assert dict(shown(batch).readings)["end"] == "stalled"


@pytest.mark.parametrize("tilt", [0.0, 0.1, 0.26])
def test_a_tilt_is_told(tilt: float) -> None:
    start = Start(PARCELS["S"], (0.2, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,), tilt=tilt)
    assert shown(batch_with(start)).tilt == pytest.approx(tilt)
