"""Scenes in Python: what a run is, what is written and read, and what a page cannot show."""

import json
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.env import make_batch
from surface_gym.web.scene import MARK, TableScene, TaskScene, ThrownParcel, pack, unpack
from surface_gym.web.starts import collect_starts

BOX = ThrownParcel(sg.layouts.box("S"), (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
OTHER = ThrownParcel(
    sg.Parcel(sg.Polygon([[0, 0], [0.3, 0], [0.1, 0.2]]), 2.0, 0.05, com_offset=(0.01, 0.0)),
    (0.5, 1.0, 0.5),
    (0.5, 0.1, 1.0),
)
SCENE = TableScene(sg.layouts.sorting(), (BOX,), duration=1.0)


def test_a_run_of_one_parcel_is_that_of_simulate():
    found = SCENE.run().trajectories[0]
    wanted = sg.simulate(SCENE.surface, BOX.parcel, BOX.pose, BOX.velocity, 1.0)
    assert (found.pose == wanted.pose).all()
    assert (found.velocity == wanted.velocity).all()
    assert found.end == wanted.end == "duration"


def test_a_run_of_several_is_that_of_simulate_together():
    scene = replace(SCENE, parcels=(BOX, OTHER), restitution=0.5)
    found = scene.run()
    wanted = sg.simulate_together(
        scene.surface, [BOX.parcel, OTHER.parcel], [BOX.pose, OTHER.pose],
        [BOX.velocity, OTHER.velocity], 1.0, restitution=0.5,
    )  # fmt: skip
    assert len(wanted.touches.time) > 0
    assert (found.touches.impulse == wanted.touches.impulse).all()
    for mine, theirs in zip(found.trajectories, wanted.trajectories, strict=True):
        assert (mine.pose == theirs.pose).all()


def test_a_parcel_that_comes_later_is_not_there_before():
    late = replace(BOX, step=100)
    found = replace(SCENE, parcels=(late,)).run().trajectories[0]
    assert found.time[0] == 0.5
    wanted = sg.simulate(SCENE.surface, BOX.parcel, BOX.pose, BOX.velocity, 0.5)
    assert (found.pose == wanted.pose).all()


def test_a_surface_changes_on_the_way():
    rolling = sg.layouts.line([[np.pi / 2]])
    changed = replace(SCENE, changes=((20, rolling),)).run().trajectories[0]
    same = SCENE.run().trajectories[0]
    assert (changed.pose[:21] == same.pose[:21]).all()
    assert changed.pose[-1, 0] > same.pose[-1, 0]


@pytest.mark.parametrize(
    "scene",
    [
        SCENE,
        replace(
            SCENE, parcels=(replace(OTHER, step=3), ThrownParcel(sg.Parcel(sg.Disc(0.1)), BOX.pose))
        ),
        replace(SCENE, changes=((5, sg.layouts.sorting(side=1, tilt=0.1)),)),
        TableScene(replace(sg.layouts.sorting(), mu_max=0.6, tilt=0.1, tilt_direction=1.0)),
    ],
    ids=["one", "shapes", "changes", "no parcel"],
)
def test_what_is_written_is_read(scene):
    read = TableScene.from_url(scene.url("page.html"))
    assert read.to_json() == scene.to_json()
    if scene.parcels:
        ends = [[each.pose[-1].tolist() for each in s.run().trajectories] for s in (scene, read)]
        assert ends[0] == ends[1]


def test_a_task_s_scene_has_an_address():
    made = TaskScene("sort", 3, "sort-ppo", ((10, 4),), 1, ((2, ((5, 1),)),))
    fields = json.loads(unpack(made.url().partition("#")[2]))
    assert fields["stuck"] == [[10, 4]]
    assert fields["commands"] == [[2, [[5, 1]]]]
    with pytest.raises(ValueError, match="task must be one of"):
        TaskScene("dance")


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (replace(SCENE, parcels=(BOX,) * 25), "at most 24 in a page, got 25"),
        (replace(SCENE, duration=100.0), "duration must be"),
        (
            TableScene(sg.Surface(np.zeros((100, 100)), np.ones((100, 100), bool))),
            "at most 6000 modules in a page, got 10000",
        ),
        (
            TableScene(replace(sg.layouts.sorting(), stiffness=np.ones((20, 40)))),
            "one friction and one stiffness",
        ),
        (
            replace(SCENE, parcels=(replace(BOX, parcel=replace(BOX.parcel, inertia=0.2)),)),
            "inertia must be None",
        ),
        (
            replace(SCENE, changes=((1, replace(SCENE.surface, origin=(0.0, 0.0))),)),
            "changes must leave",
        ),
    ],
    ids=["parcels", "long", "large", "stiffness", "inertia", "another table"],
)
def test_what_a_page_cannot_show_is_refused(scene, said):
    with pytest.raises(ValueError, match=said):
        scene.url()


def test_a_scene_without_parcels_does_not_run():
    with pytest.raises(ValueError, match="parcels must be at least one"):
        TableScene(SCENE.surface).run()


FIELDS = json.loads(SCENE.to_json())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "must be the scene of a table"),
        ("[]", "must be the scene of a table"),
        ("{}", "must be the scene of a table"),
        (json.dumps({**FIELDS, "version": 2}), "version must be"),
        (json.dumps({**FIELDS, "task": "sort"}), "task must be"),
        (json.dumps({**FIELDS, "axis": [[0.0, 10**9]]}), "many must be"),
        (json.dumps({**FIELDS, "axis": [[0.0, 10]]}), "reshape"),
        (json.dumps({**FIELDS, "tilt": 2.0}), "tilt must be"),
    ],
    ids=["half", "a list", "empty", "version", "task", "huge", "too few", "steep"],
)
def test_a_bad_scene_is_refused(text, said):
    with pytest.raises(ValueError, match=said):
        TableScene.from_json(text)


@pytest.mark.parametrize(
    "fragment", ["", "2.abc", MARK + "%%%", pack(SCENE.to_json())[:-8], MARK], ids=range(5)
)
def test_a_bad_address_is_refused(fragment):
    with pytest.raises(ValueError, match="url must hold a"):
        TableScene.from_url(f"playground.html#{fragment}")


def test_an_address_that_unpacks_to_too_much_is_refused():
    with pytest.raises(ValueError, match="cut short or damaged"):
        unpack(pack(" " * 3_000_000))


@pytest.mark.parametrize("task", ["sort", "stop", "slow", "orient", "track", "flow", "merge"])
def test_starts_are_those_of_the_environment_and_their_goals_are_marked(task):
    batch = make_batch(EnvConfig(task), 1, compiles=False)
    starts = collect_starts(batch, 3)
    assert len(starts.marks) == 3
    assert all(mark["points"] for marks in starts.marks for mark in marks)
    assert starts.marks[0] != []
    sizes = {
        name: np.asarray(value).nbytes
        for name, value in batch.parcels._asdict().items()
        if f"parcels.{name}" in starts.fields
    }
    assert len(starts.block) % 3 == 0
    assert sum(sizes.values()) <= len(starts.block) / 3
    again = collect_starts(make_batch(EnvConfig(task), 1, compiles=False), 3)
    assert again == starts
