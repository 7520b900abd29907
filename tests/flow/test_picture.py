"""From a flow's surface to the scene that is drawn, and the environments' pictures."""

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
import pytest

import surface_gym as sg
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.exits import Exit, Exits
from surface_gym.flow.memory import BETWEEN, JAM, ON_ITS_WAY, TOUCHES
from surface_gym.flow.picture import GLIDE, TRAIL, Album, exit_marks
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.lines import Pattern
from surface_gym.registration import FLOW
from surface_gym.rendering import FlowScene
from tests.flow.flows import (
    BOX,
    LARGE_BOX,
    PLUS_45,
    ROLL,
    SHORT,
    bare,
    batch_with,
    play,
    same_choice,
    set_down,
    trace,
    truths,
)

PERIOD = 0.04  # [s]
THREE = (Exit("left", 1, 0.5, 2.0), Exit("right", -1), Exit("straight", 0))


def batch_of(stream: Stream, **settings: Any) -> FlowBatch:
    return batch_with(stream, **{"exits": Exits(THREE), "duration": 120.0, **settings})


def opened(batch: FlowBatch) -> Album:
    """The album of a batch of one that has just begun."""
    album = Album(batch, 0)
    album.record(begins=True)
    return album


def go_on(batch: FlowBatch, album: Album, periods: int, choice: int = ROLL) -> None:
    for _ in range(periods):
        batch.advance(np.full(batch.surfaces.command.shape, choice))
        album.record(begins=False)


def reading(scene: FlowScene, label: str) -> str:
    return dict(scene.readings)[label]


class TestParcels:
    def test_all_on_the_line_are_shown_where_they_are(self) -> None:
        batch = batch_of(trace((0.0, "left"), (0.4, "straight"), (0.8, "right")))
        album = opened(batch)
        go_on(batch, album, 25)
        scene, known = album.scene(), truths(batch)
        assert [parcel.exit for parcel in scene.parcels] == [0, 2, 1]
        assert [parcel.label for parcel in scene.parcels] == ["L", "S", "R"]
        for number, parcel in enumerate(scene.parcels):
            assert parcel.pose == tuple(known[number][:3])
            np.testing.assert_allclose(parcel.outline, BOX.base.outline, atol=1e-15)

    def test_a_round_base_is_a_circle(self) -> None:
        disc = sg.Parcel(sg.Disc(0.15), 1.0)
        batch = batch_of(trace((0.0, "left"), parcel=disc))
        outline = opened(batch).scene().parcels[0].outline
        np.testing.assert_allclose(np.hypot(*outline.T), 0.15)

    def test_names_whose_initials_are_the_same_are_written_in_full(self) -> None:
        exits = Exits((Exit("lane", 1), Exit("left", -1)))
        album = opened(batch_of(trace((0.0, "left")), exits=exits))
        assert album.scene().parcels[0].label == "left"

    def test_a_sensed_pose_is_shown_where_it_is_another(self) -> None:
        batch = batch_of(trace((0.0, "left")))
        album = opened(batch)
        assert album.scene().parcels[0].sensed_pose is None
        batch.parcels.sensed[0, 1] += 0.02
        x, y, theta = album.scene().parcels[0].pose
        assert album.scene().parcels[0].sensed_pose == pytest.approx((x, y + 0.02, theta))

    def test_those_that_touch_are_paired_for_a_moment(self) -> None:
        batch = batch_of(trace((0.0, "left"), (0.0, "straight")))
        set_down(batch, [[0.8, 1.0, 0.0], [1.1, 1.0, 0.0]], [[1.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
        album = opened(batch)
        assert album.scene().touching == ()
        while batch.streams.tally[0, TOUCHES] == 0:  # the one behind catches up
            go_on(batch, album, 1)
        assert album.scene().touching == ((0, 1),)
        # Whether they have done so within 0.1 s, 20 physics steps, whatever came since.
        for since, expected in ((20, ((0, 1),)), (21, ())):
            batch.streams.touched_at[0, [0, 1], [1, 0]] = batch.streams.steps[0] - since
            assert album.scene().touching == expected


class TestTrails:
    def test_they_end_at_the_centre_and_are_short(self) -> None:
        batch = batch_of(trace((0.0, "straight")))
        album = opened(batch)
        lengths = []
        for _ in range(20):
            go_on(batch, album, 1)
            parcel = album.scene().parcels[0]
            assert tuple(parcel.trail[-1]) == parcel.pose[:2]
            lengths.append(np.hypot(*np.diff(parcel.trail, axis=0).T).sum())
        assert lengths == sorted(lengths[:9]) + lengths[9:]
        assert max(lengths) <= TRAIL
        assert min(lengths[10:]) > TRAIL - 1.5 * PERIOD

    def test_a_place_used_again_does_not_join_them(self) -> None:
        batch = batch_of(trace((0.0, "straight"), (0.0, "straight")), places=1)
        album = opened(batch)
        while batch.streams.number[0, 0] != 1:
            go_on(batch, album, 1)
        go_on(batch, album, 3)
        trail = album.scene().parcels[-1].trail
        assert len(trail) == 4
        assert trail[:, 0].max() < 0.5

    def test_an_episode_begins_without_any(self) -> None:
        batch = batch_of(trace((0.0, "straight")))
        album = opened(batch)
        go_on(batch, album, 42)  # it has left, and is shown yet
        assert len(album.scene().parcels) == 1
        batch.start(np.array([0]))
        album.record(begins=True)
        (parcel,) = album.scene().parcels
        np.testing.assert_array_equal(parcel.trail, [parcel.pose[:2]])


class TestExits:
    def test_who_has_left_goes_on_for_a_moment(self) -> None:
        batch = batch_of(trace((0.0, "straight")))
        album = opened(batch)
        while batch.streams.present[0, 0]:
            go_on(batch, album, 1)
        left, (x, y, _, vx, vy, _) = batch.streams.left[0, 0], batch.parcels.truth[0].copy()
        periods = 0
        while album.scene().parcels:
            (parcel,) = album.scene().parcels
            since = batch.streams.clock[0] - left
            assert parcel.pose[:2] == pytest.approx((x + since * vx, y + since * vy))
            assert tuple(parcel.trail[-1]) == parcel.pose[:2]
            go_on(batch, album, 1)
            periods += 1
        assert GLIDE - PERIOD <= periods * PERIOD <= GLIDE + PERIOD

    def test_pairs_are_counted_past_those_who_have_left(self) -> None:
        batch = batch_of(trace((0.0, "straight"), (0.2, "left"), (0.6, "right")))
        album = opened(batch)
        while batch.streams.present[0, 0]:
            go_on(batch, album, 1)
        batch.streams.touched_at[0, [1, 2], [2, 1]] = batch.streams.steps[0]
        scene = album.scene()
        assert [parcel.exit for parcel in scene.parcels] == [2, 0, 1]
        assert scene.touching == ((1, 2),)

    def test_counts_and_those_who_wait(self) -> None:
        names = ("straight", "left", "straight", "right", "straight")
        batch = batch_of(trace(*[(0.5 * k, name) for k, name in enumerate(names)], (9.0, "left")))
        album = opened(batch)
        go_on(batch, album, 120)  # all roll straight on
        scene = album.scene()
        assert scene.delivered == (0, 0, 3)
        assert scene.missorted == 2
        crowd = opened(batch_of(trace(*[(0.0, "left")] * 4))).scene()
        assert (len(crowd.parcels), crowd.waiting) == (1, 3)

    def test_spans_end_with_the_surface(self) -> None:
        exits = Exits(
            (Exit("a", 1, -3.0, 0.5), Exit("b", 1, 0.5), Exit("c", -1, 0.5, 9.0), Exit("on", 0))
        )
        marks = exit_marks(FlowSettings(plant=SHORT, exits=exits))
        spans = {mark.name: (mark.side, mark.first, mark.last) for mark in marks}
        assert spans["a"] == pytest.approx((1, 0.0, 0.5))
        assert spans["b"] == pytest.approx((1, 0.5, 2.0))  # the rotors' end
        assert spans["c"] == pytest.approx((-1, 0.5, 2.0))
        assert spans["on"] == pytest.approx((0, 2.0, 2.6))  # and the surface's

    def test_where_rotors_end_with_the_surface_the_way_on_is_the_last_column(self) -> None:
        rotor = np.zeros((20, 20), dtype=bool)
        rotor[8:12] = True
        settings = FlowSettings(plant=Pattern(rotor=rotor, lead_in=5), exits="sides")
        on = exit_marks(settings)[-1]
        assert (on.first, on.last) == pytest.approx((1.9, 2.0))

    def test_a_chute_past_the_rotors_cannot_be_drawn(self) -> None:
        exits = Exits((Exit("beyond", 1, 2.5, 3.0),))
        with pytest.raises(ValueError, match=r"last must be greater than first, 2\.5"):
            exit_marks(FlowSettings(plant=SHORT, exits=exits))


class TestReadings:
    def test_axes_zone_and_tilt_are_the_surfaces(self) -> None:
        batch = batch_of(trace((0.0, "left")), tilt=0.05)
        album = opened(batch)
        go_on(batch, album, 3, PLUS_45)
        scene = album.scene("lane 0")
        assert (scene.title, scene.tilt) == ("lane 0", 0.05)
        assert scene.zone == batch.settings.zone
        expected = np.where(scene.obeys & scene.rotor, math.pi / 4, math.pi / 2)
        np.testing.assert_allclose(scene.axis, expected)
        assert reading(scene, "time") == "0.1 s"

    def test_the_rate_is_that_of_the_last_half_minute(self) -> None:
        batch = batch_of(trace(*[(float(k), "straight") for k in range(60)]))
        flows, album = batch.streams, opened(batch)
        assert reading(album.scene(), "parcels an hour") == "\N{EN DASH}"
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
            flows.clock[0] = clock
            flows.left[0, :60] = np.where(gone, left, np.nan)
            flows.taken[0, :60] = np.where(gone, np.where(right, 2, BETWEEN), ON_ITS_WAY)
            rate = expected if isinstance(expected, str) else f"{expected:.0f}"
            assert reading(album.scene(), "parcels an hour") == rate

    def test_an_end_is_told(self) -> None:
        batch = batch_of(trace((0.0, "left")))
        album = opened(batch)
        assert "end" not in dict(album.scene().readings)
        batch.streams.outcome[0] = JAM
        assert reading(album.scene(), "end") == "jam"


class TestEnvironments:
    @pytest.mark.parametrize("actions", ["modules", "parcels"])
    def test_a_picture_a_step(self, actions: str) -> None:
        env = bare(actions=actions, render_mode="rgb_array")
        env.reset(seed=1)
        before = env.render()
        assert before.dtype == np.uint8
        env.step(same_choice(env, PLUS_45))
        after = env.render()
        assert after.shape == before.shape
        assert (after != before).any()

    def test_drawing_changes_nothing(self) -> None:
        plain, drawn = bare(), bare(render_mode="rgb_array")
        for one, other in zip(play(plain, PLUS_45), play(drawn, PLUS_45), strict=True):
            drawn.render()
            np.testing.assert_array_equal(one[0], other[0])
            assert one[1] == other[1]

    def test_a_gate_is_no_parcel(self) -> None:
        stream = trace((0.0, "straight"), (0.0, "left 1"))
        env = bare(stream=stream, gate=True, render_mode="rgb_array")
        env.reset(seed=0)
        env.step(np.append(same_choice(env, ROLL)[:-1], 1))  # lets the first one in
        album = env._album
        assert [parcel.label for parcel in album.scene().parcels] == ["S"]
        assert album.scene().waiting == 1

    def test_films(self, tmp_path: Path) -> None:
        made = gym.make(FLOW, duration=0.4, plant=SHORT, render_mode="rgb_array")
        env: Any = gym.wrappers.RecordVideo(made, str(tmp_path / "films"))
        env.reset(seed=0)
        over = False
        while not over:
            _, _, _, over, _ = env.step(env.action_space.sample())
        env.close()
        assert [file.suffix for file in (tmp_path / "films").iterdir()] == [".mp4"]

    def test_tiles(self) -> None:
        envs: Any = gym.make_vec(
            FLOW, 3, plant=SHORT, duration=0.2, stream=trace((0.0, "straight"), parcel=LARGE_BOX),
            render_mode="rgb_array",
        )  # fmt: skip
        envs.reset(seed=0)
        pictures = []
        for _ in range(7):  # past the end, into the next episode
            pictures += envs.render()
            envs.step(envs.action_space.sample())
        assert {picture.shape[1:] for picture in pictures} == {(1280, 3)}
        assert all((one != other).any() for one, other in pairwise(pictures))

    @pytest.mark.usefixtures("screen")
    def test_a_window(self) -> None:
        env = bare(render_mode="human")
        env.reset(seed=0)
        env.step(same_choice(env, ROLL))
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        np.testing.assert_array_equal(shown, env._album.draw())
        env.close()


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()
