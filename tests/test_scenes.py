"""From a batch's environments to scenes, and the environments' pictures."""

import math
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.batch import BaseBatch, Batch
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.exits import LEFT, START, Exit, Exits, Inlet, Inlets
from surface_gym.flow.state import BETWEEN, JAM, ON_ITS_WAY, TOUCHES
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import Stops
from surface_gym.lines import Pattern
from surface_gym.registration import env_id
from surface_gym.rendering import Scene, SceneParcel
from surface_gym.scenes import GLIDE, TRAIL, Renderer, exit_marks, inlet_marks
from surface_gym.tasks import TASKS
from surface_gym.tasks.start import Start
from tests.environments import FLOW, HEPTAGON, PARCELS, STREAMS, batch_with as batch_at, begun, put
from tests.flow import flows
from tests.flow.flows import BOX, PLUS_45, ROLL, SHORT, bare, same_choice, trace, truths

PERIOD = 0.04  # [s]
THREE = (Exit("left", 1, 0.5, 2.0), Exit("right", -1), Exit("straight", 0))


def pair_of(parcel: sg.Parcel, task: str = "sort") -> Batch:
    """Two environments with one parcel each."""
    return begun(EnvConfig(task=task), 2, options=[{"speed": 1.0, "parcel": parcel}] * 2)


def shown(batch: BaseBatch, i: int = 0) -> Scene:
    return opened(batch, i).scene(i)


def only(scene: Scene) -> SceneParcel:
    (parcel,) = scene.parcels
    return parcel


def stream_of(*arrivals: tuple[float, str], **settings: Any) -> StreamBatch:
    given = {"exits": Exits(THREE), "duration": 120.0, **settings}
    return flows.batch_with(trace(*arrivals), **given)


def opened(batch: BaseBatch, i: int = 0) -> Renderer:
    renderer = Renderer(batch)
    renderer.record(i, begins=True)
    return renderer


def running(*arrivals: tuple[float, str], **settings: Any) -> tuple[StreamBatch, Renderer]:
    batch = stream_of(*arrivals, **settings)
    return batch, opened(batch)


def go_on(batch: StreamBatch, renderer: Renderer, periods: int, choice: int = ROLL) -> None:
    for _ in range(periods):
        batch.step(np.full(batch.surfaces.command.shape, choice))
        renderer.record(0, begins=False)


def reading(scene: Scene, label: str) -> str:
    return dict(scene.readings)[label]


class TestOneParcel:
    @pytest.mark.parametrize("task", TASKS)
    def test_every_task_has_a_scene_with_its_goal(self, task):
        scene = shown(pair_of(PARCELS["S"], task))
        assert scene.title == task.capitalize()
        assert scene.goal is not None
        labels = [label for label, _ in scene.readings]
        assert labels[:3] == ["time", "speed", "heading"]
        assert len(labels) > 3
        assert len(set(labels)) == len(labels)

    @pytest.mark.parametrize("parcel", PARCELS.values(), ids=PARCELS)
    def test_the_outline_is_the_bases(self, parcel):
        batch = pair_of(parcel)
        put(batch, Start(HEPTAGON, (0.2, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,)), i=1)
        outline = only(shown(batch)).outline
        if isinstance(parcel.base, sg.Disc):
            np.testing.assert_allclose(np.hypot(*outline.T), parcel.base.radius)
        else:
            np.testing.assert_allclose(
                outline + parcel.base.centroid, parcel.base.outline, atol=1e-15
            )

    def test_axes_zone_and_pose_are_the_batch_s(self):
        batch = pair_of(PARCELS["S"])
        for _ in range(3):
            batch.step(np.full((2, 64), PLUS_45))
        for i in (0, 1):
            scene = shown(batch, i)
            assert only(scene).pose == tuple(batch.parcels.truth[i, :3])
            first_row, rows, first_column, columns = scene.zone
            zone = np.zeros(scene.axis.shape, dtype=bool)
            zone[first_row : first_row + rows, first_column : first_column + columns] = True
            np.testing.assert_allclose(scene.axis, np.where(zone, math.pi / 4, math.pi / 2))
            np.testing.assert_array_equal(scene.rotor, batch.view(i).rotor)
        assert dict(scene.readings)["time"] == "0.12 s"

    @pytest.mark.parametrize("flows", [False, True], ids=["one parcel", "stream"])
    def test_a_sensed_pose_is_shown_where_it_is_another(self, flows):
        batch = stream_of((0.0, "left")) if flows else pair_of(PARCELS["S"])
        assert only(shown(batch)).sensed_pose is None
        batch.parcels.sensed[0, 1] += 0.02
        x, y, theta = only(shown(batch)).pose
        assert only(shown(batch)).sensed_pose == pytest.approx((x, y + 0.02, theta))

    def test_an_end_and_a_tilt_are_shown(self):
        batch = pair_of(PARCELS["S"])
        assert "end" not in dict(shown(batch).readings)
        while batch.parcels.outcome[0] == 0:
            batch.step(np.full((2, 64), 0))
        assert reading(shown(batch), "end") == "stalled"

        for tilt, direction in ((0.0, 0.0), (0.26, 0.0), (-0.26, 0.0), (0.26, 2.5)):
            start = Start(
                PARCELS["S"], (0.2, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,), tilt,
                tilt_direction=direction,
            )  # fmt: skip
            scene = shown(batch_at(start))
            assert (scene.tilt, scene.tilt_direction) == pytest.approx((tilt, direction))


class TestParcelsOfAStream:
    def test_all_on_the_line_are_shown_where_they_are(self):
        batch, renderer = running((0.0, "left"), (0.4, "straight"), (0.8, "right"))
        go_on(batch, renderer, 25)
        scene, known = renderer.scene(), truths(batch)
        assert [parcel.exit for parcel in scene.parcels] == [0, 2, 1]
        assert [parcel.label for parcel in scene.parcels] == ["L", "S", "R"]
        for number, parcel in enumerate(scene.parcels):
            assert parcel.pose == tuple(known[number][:3])
            np.testing.assert_allclose(parcel.outline, BOX.base.outline, atol=1e-15)

    def test_names_whose_initials_are_the_same_are_written_in_full(self):
        exits = Exits((Exit("loft", 1), Exit("left", -1)))
        assert only(shown(stream_of((0.0, "left"), exits=exits))).label == "left"

    def test_those_that_touch_are_paired_for_a_moment(self):
        batch = stream_of((0.0, "left"), (0.0, "straight"))
        poses, velocities = [[0.8, 1.0, 0.0], [1.1, 1.0, 0.0]], [[1.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
        flows.set_down(batch, poses, velocities)
        renderer = opened(batch)
        assert renderer.scene().touching == ()
        while batch.streams.tally[0, TOUCHES] == 0:  # the one behind catches up
            go_on(batch, renderer, 1)
        assert renderer.scene().touching == ((0, 1),)
        # Whether they have done so within 0.1 s, 20 physics steps, whatever came since.
        for since, expected in ((20, ((0, 1),)), (21, ())):
            batch.streams.touched_at[0, [0, 1], [1, 0]] = batch.streams.steps[0] - since
            assert renderer.scene().touching == expected


class TestTrails:
    def test_they_end_at_the_centre_and_are_short(self):
        batch, renderer = running((0.0, "straight"))
        lengths = []
        for _ in range(20):
            go_on(batch, renderer, 1)
            parcel = renderer.scene().parcels[0]
            assert tuple(parcel.trail[-1]) == parcel.pose[:2]
            lengths.append(np.hypot(*np.diff(parcel.trail, axis=0).T).sum())
        assert lengths == sorted(lengths[:9]) + lengths[9:]
        assert max(lengths) <= TRAIL
        assert min(lengths[10:]) > TRAIL - 1.5 * PERIOD

    def test_a_place_used_again_does_not_join_them(self):
        batch, renderer = running((0.0, "straight"), (0.0, "straight"), max_parcels=1)
        while batch.streams.number[0, 0] != 1:
            go_on(batch, renderer, 1)
        go_on(batch, renderer, 3)
        trail = renderer.scene().parcels[-1].trail
        assert len(trail) == 4
        assert trail[:, 0].max() < 0.5

    def test_an_episode_begins_without_any(self):
        batch, renderer = running((0.0, "straight"))
        go_on(batch, renderer, 42)  # it has left, and is shown yet
        assert len(renderer.scene().parcels) == 1
        batch.reset(np.array([0]))
        renderer.record(0, begins=True)
        parcel = only(renderer.scene())
        np.testing.assert_array_equal(parcel.trail, [parcel.pose[:2]])


class TestExits:
    def test_who_has_left_goes_on_for_a_moment(self):
        batch, renderer = running((0.0, "straight"))
        while batch.streams.present[0, 0]:
            go_on(batch, renderer, 1)
        left, (x, y, _, vx, vy, _) = batch.streams.departed[0, 0], batch.parcels.truth[0].copy()
        periods = 0
        while renderer.scene().parcels:
            parcel = only(renderer.scene())
            since = batch.streams.clock[0] - left
            assert parcel.pose[:2] == pytest.approx((x + since * vx, y + since * vy))
            assert tuple(parcel.trail[-1]) == parcel.pose[:2]
            go_on(batch, renderer, 1)
            periods += 1
        assert GLIDE - PERIOD <= periods * PERIOD <= GLIDE + PERIOD

    def test_pairs_are_counted_past_those_who_have_left(self):
        batch, renderer = running((0.0, "straight"), (0.2, "left"), (0.6, "right"))
        while batch.streams.present[0, 0]:
            go_on(batch, renderer, 1)
        batch.streams.touched_at[0, [1, 2], [2, 1]] = batch.streams.steps[0]
        scene = renderer.scene()
        assert [parcel.exit for parcel in scene.parcels] == [2, 0, 1]
        assert scene.touching == ((1, 2),)

    def test_counts_and_those_who_wait(self):
        names = ("straight", "left", "straight", "right", "straight")
        batch, renderer = running(*[(0.5 * k, name) for k, name in enumerate(names)], (9.0, "left"))
        go_on(batch, renderer, 120)  # all roll straight on
        scene = renderer.scene()
        assert scene.traffic.delivered == (0, 0, 3)
        assert scene.traffic.missorted == 2
        crowd = shown(stream_of(*[(0.0, "left")] * 4))
        assert (len(crowd.parcels), crowd.traffic.waiting) == (1, 3)

    def test_spans_end_with_the_surface(self):
        exits = Exits(
            (Exit("a", 1, -3.0, 0.5), Exit("b", 1, 0.5), Exit("c", -1, 0.5, 9.0), Exit("on", 0))
        )
        marks = exit_marks(EnvConfig("flow", line=SHORT, exits=exits))
        spans = {mark.name: (mark.side, mark.first, mark.last) for mark in marks}
        assert spans["a"] == pytest.approx((1, 0.0, 0.5))
        assert spans["b"] == pytest.approx((1, 0.5, 2.0))  # the rotors' end
        assert spans["c"] == pytest.approx((-1, 0.5, 2.0))
        assert spans["on"] == pytest.approx((0, 2.0, 2.6))  # and the surface's

    def test_no_exit_lies_past_the_rotors_but_the_way_on_which_takes_the_last_column(self):
        rotor = np.zeros((20, 20), dtype=bool)
        rotor[8:12] = True
        settings = EnvConfig("flow", line=Pattern(rotor=rotor, lead_in=5), exits="sides")
        on = exit_marks(settings)[-1]
        assert (on.first, on.last) == pytest.approx((1.9, 2.0))
        exits = Exits((Exit("beyond", 1, 2.5, 3.0),))
        with pytest.raises(ValueError, match="exits must lie beside the rotors, from 0 to 2 m"):
            EnvConfig("flow", line=SHORT, exits=exits)


def sloping(task: str, rate: float = 3600.0, **settings: Any) -> tuple[StreamBatch, Renderer]:
    """A slope of one environment that has just begun, with an S-box a second by default."""
    window = settings.pop("window", 1)
    stream = settings.pop("stream", Stream(Steady(rate), speeds=0.8, window=window))
    given = {"actions": "parcels", "duration": 60.0, **settings}
    batch = begun(EnvConfig(task, stream=stream, **given))
    return batch, opened(batch)


class TestSlopes:
    """Scenes of the tasks whose parcels leave onto a take-away."""

    def test_mouths_span_y_and_the_end_all_rows(self):
        (mark,) = exit_marks(EnvConfig("singulate", exits="mouth"))
        assert (mark.first, mark.last) == pytest.approx((5.0, 5.6))
        assert mark.span == pytest.approx((0.4, 1.0))
        assert exit_marks(EnvConfig("singulate"))[0].span is None
        half = Exits((Exit("half", 0, 0.1),))
        assert exit_marks(EnvConfig("singulate", exits=half))[0].span == pytest.approx((0.8, 1.4))

    def test_inlets_have_marks_but_for_the_whole_edge(self):
        assert inlet_marks(EnvConfig("singulate")) == ()
        inlets = Inlets((Inlet("above", START, -0.2, 0.4), Inlet("aside", LEFT, 1.0, 2.0)))
        marks = inlet_marks(EnvConfig("merge", inlets=inlets))
        assert [(mark.name, mark.side) for mark in marks] == [("above", START), ("aside", LEFT)]
        assert (marks[0].first, marks[0].last) == pytest.approx((0.5, 1.1))
        assert (marks[1].first, marks[1].last) == pytest.approx((1.0, 2.0))

    @pytest.mark.parametrize("task", ["singulate", "merge", "sequence"])
    def test_colours_and_labels_tell_parcels_apart(self, task):
        batch, renderer = sloping(task, 7200.0, window=2 if task == "sequence" else 1)
        go_on(batch, renderer, 50)
        parcels, streams = renderer.scene().parcels, batch.streams
        assert len(parcels) > 2
        assert all(parcel.exit is None for parcel in parcels)
        order = streams.order[0, : len(parcels)].tolist()
        groups, labels = {
            "singulate": ([0] * len(parcels), [""] * len(parcels)),
            "merge": (streams.inlet[0, : len(parcels)].tolist(), [""] * len(parcels)),
            "sequence": ([place // 2 for place in order], [str(place) for place in order]),
        }[task]
        assert [parcel.group for parcel in parcels] == groups
        assert [parcel.label for parcel in parcels] == labels

    def test_those_right_are_counted_and_those_wrong_are_marked(self):
        batch, renderer = sloping("singulate", 6000.0, gap=1.5)
        wrong = set()
        for _ in range(120):  # all roll on, closer together than is asked for
            go_on(batch, renderer, 1)
            wrong |= {parcel.wrong for parcel in renderer.scene().parcels}
        traffic, right = renderer.scene().traffic, int(batch.streams.correct.sum())
        assert traffic.delivered == (right,)
        assert traffic.missorted == int((batch.streams.taken[0] >= BETWEEN).sum()) - right > 0
        assert wrong == {False, True}

    def test_each_line_has_its_queue(self):
        batch, renderer = sloping("merge", 60000.0)
        go_on(batch, renderer, 25)
        traffic, streams = renderer.scene().traffic, batch.streams
        due = int(streams.due[0])
        waits = np.isnan(streams.entered[0, :due])
        expected = np.bincount(streams.inlet[0, :due][waits], minlength=3)
        assert traffic.queues == tuple(expected)
        assert sum(traffic.queues) == traffic.waiting > 3

    def test_it_is_shown_whether_the_take_away_runs(self):
        batch, renderer = sloping("singulate", demand=Stops((1.0, 1.0), (1.0, 1.0)))
        runs = []
        for _ in range(3):
            runs.append(renderer.scene().traffic.runs)
            go_on(batch, renderer, 26)
        assert runs == [True, False, True]
        assert shown(stream_of((0.0, "left"))).traffic.runs is None


class TestReadings:
    def test_axes_zone_and_tilt_are_the_surfaces(self):
        batch, renderer = running((0.0, "left"), tilt=0.05, tilt_direction=1.2)
        go_on(batch, renderer, 3, PLUS_45)
        scene = renderer.scene(0, "env 0")
        assert (scene.title, scene.tilt, scene.tilt_direction) == ("env 0", 0.05, 1.2)
        assert scene.zone == batch.config.site.zone
        expected = np.where(scene.obeys & scene.rotor, math.pi / 4, math.pi / 2)
        np.testing.assert_allclose(scene.axis, expected)
        assert reading(scene, "time") == "0.1 s"

    def test_the_rate_is_that_of_the_last_half_minute(self):
        batch = stream_of(*[(float(k), "straight") for k in range(60)])
        streams, renderer = batch.streams, opened(batch)
        assert reading(renderer.scene(), "parcels an hour") == "\N{EN DASH}"
        # One leaves a second from 1 s on: every third by another exit, and all do from 40 s on.
        left = np.arange(1.0, 61.0)
        right = (left % 3.0 != 0.0) & (left < 40.0)
        for clock, expected in (
            (5.9, "\N{EN DASH}"),  # 5 s since the first left are the least
            (6.0, 3600.0 * 3 / 5),  # at 2, 4 and 5 s; the one at 1 s but begins the time
            (31.0, 3600.0 * 20 / 30),
            (45.0, 3600.0 * 16 / 30),  # 24 from 16 s on, of which eight are wrong
            (60.0, 3600.0 * 6 / 30),
        ):
            gone = left <= clock
            streams.clock[0] = clock
            streams.departed[0, :60] = np.where(gone, left, np.nan)
            streams.taken[0, :60] = np.where(gone, np.where(right, 2, BETWEEN), ON_ITS_WAY)
            streams.correct[0, :60] = gone & right
            rate = expected if isinstance(expected, str) else f"{expected:.0f}"
            assert reading(renderer.scene(), "parcels an hour") == rate

    def test_an_end_is_shown(self):
        batch, renderer = running((0.0, "left"))
        assert "end" not in dict(renderer.scene().readings)
        batch.streams.outcome[0] = JAM
        assert reading(renderer.scene(), "end") == "jam"


class TestEnvironments:
    @pytest.mark.parametrize(
        ("task", "actions"), [("flow", "modules"), *((task, "parcels") for task in STREAMS)]
    )
    def test_a_picture_a_step(self, task, actions):
        env: Any = gym.make(env_id(task), actions=actions, render_mode="rgb_array")
        env.reset(seed=1)
        before = env.render()
        assert before.dtype == np.uint8
        env.step(same_choice(env, PLUS_45))
        after = env.render()
        assert after.shape == before.shape
        assert (after != before).any()

    def test_drawing_changes_nothing(self):
        plain, drawn = bare(), bare(render_mode="rgb_array")
        drawn.reset(seed=0)
        for one in flows.play(plain, PLUS_45):
            drawn.render()
            other = drawn.step(same_choice(drawn, PLUS_45))
            np.testing.assert_array_equal(one[0], other[0])
            assert one[1] == other[1]

    def test_a_gate_is_no_parcel(self):
        stream = trace((0.0, "straight"), (0.0, "left 1"))
        env = bare(stream=stream, gate=True, render_mode="rgb_array")
        env.reset(seed=0)
        env.step(np.append(same_choice(env, ROLL)[:-1], 1))  # lets the first one in
        renderer = env._renderer
        assert [parcel.label for parcel in renderer.scene().parcels] == ["S"]
        assert renderer.scene().traffic.waiting == 1

    def test_films(self, tmp_path):
        made = gym.make(FLOW, duration=0.4, line=SHORT, render_mode="rgb_array")
        env: Any = gym.wrappers.RecordVideo(made, str(tmp_path / "films"))
        env.reset(seed=0)
        over = False
        while not over:
            _, _, _, over, _ = env.step(env.action_space.sample())
        env.close()
        assert [file.suffix for file in (tmp_path / "films").iterdir()] == [".mp4"]

    def test_tiles(self):
        envs: Any = gym.make_vec(
            FLOW, 3, line=SHORT, duration=0.2, stream=trace((0.0, "straight")),
            render_mode="rgb_array",
        )  # fmt: skip
        envs.reset(seed=0)
        pictures = []
        for _ in range(7):  # past the end, into the next episode
            pictures.append(envs.montage())
            envs.step(envs.action_space.sample())
        assert {picture.shape[1:] for picture in pictures} == {(1280, 3)}
        assert all((one != other).any() for one, other in pairwise(pictures))

    @pytest.mark.usefixtures("screen")
    def test_a_window(self):
        env = bare(render_mode="human")
        env.reset(seed=0)
        env.step(same_choice(env, ROLL))
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        np.testing.assert_array_equal(shown, env._renderer.draw())
        env.close()
