"""Tasks whose parcels leave onto a take-away: who has left rightly, gaps, stops and statistics."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import registration
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow import take_away as ta
from surface_gym.flow.arrivals import Arrival, Trace
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.exits import Exit, Inlet
from surface_gym.flow.state import JAM, ORDER
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import Stops, TakeAwayTask, bulk, bulk_parcels
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.physics.types import GRAVITY, VX, X
from tests import environments as te

TASKS = [name for name, kind in registration.TASKS.items() if issubclass(kind, TakeAwayTask)]
BOX = Parcel(Rectangle(0.4, 0.2))
ROLL, BRAKE = 3, 0


def traced(*arrivals: tuple[float, float], aside: float = 0.0, turned: float = 0.0) -> Stream:
    """Boxes by their times [s] and speeds [m/s]."""
    return Stream(Trace(tuple(Arrival(t, BOX, v, "end", None, aside, turned) for t, v in arrivals)))


def begun(stream: Stream, task: str = "singulate", **arguments: Any) -> StreamBatch:
    return te.begun(EnvConfig(task, actions="parcels", stream=stream, **arguments))


def rolled(batch: StreamBatch, seconds: float, choice: int = ROLL) -> StreamBatch:
    for _ in range(round(seconds / 0.04)):
        batch.step(np.full((1, 2 * batch.rows), choice))
    return batch


class TestLeaving:
    def test_the_gap_is_that_of_two_that_slide_until_they_have_the_belts_speed(self) -> None:
        batch = rolled(begun(traced((0.0, 0.8), (0.6, 1.1))), 4.0)
        streams = batch.streams
        left, speed = streams.departed[0, :2], streams.final[0, :2, VX]
        past = streams.final[0, :2, X] - 5.0
        times = left - past / speed  # as their centres passed the end
        slides = (speed - 2.0) * np.abs(speed - 2.0) / (2.0 * 0.5 * GRAVITY)
        expected = 2.0 * (times[1] - times[0]) + slides[0] - slides[1] - 0.4
        assert speed[0] > 3.0
        assert streams.results[0, 1, ta.GAP_BEFORE] == pytest.approx(expected, abs=2e-3)
        assert math.isnan(streams.results[0, 0, ta.GAP_BEFORE])

    @pytest.mark.parametrize(("wait", "right"), [(0.3, [True, False]), (0.5, [True, True])])
    def test_a_gap_that_is_too_small_is_the_fault_of_the_one_behind(self, wait, right) -> None:
        batch = rolled(begun(traced((0.0, 1.5), (wait, 1.5))), 3.0)
        assert batch.streams.correct[0].tolist()[:2] == right
        assert (batch.streams.results[0, 1, ta.GAP_BEFORE] >= 0.3) == right[1]

    def test_the_whole_base_must_be_within_the_mouth(self) -> None:
        for aside, right in ((0.0, True), (0.3, True), (0.4, False), (0.9, False)):
            stream = traced((0.0, 1.5), aside=aside)
            mouth = (Exit("end", 0, -0.3, 0.3),)
            batch = rolled(begun(stream, exits=mouth), 3.0)
            assert batch.streams.correct[0, 0] == right == (0.6 * aside + 0.1 <= 0.3)
        assert batch.streams.taken[0, 0] == -1  # its centre was beside it

    @pytest.mark.parametrize(("degrees", "right"), [(9.0, True), (11.0, False), (81.0, True)])
    def test_the_sides_must_be_aligned_one_way_or_the_other(self, degrees, right) -> None:
        stream = traced((0.0, 1.5), turned=math.radians(degrees))
        batch = rolled(begun(stream, alignment=math.radians(10.0)), 3.0)
        assert batch.streams.correct[0, 0] == right
        assert abs(math.degrees(batch.streams.results[0, 0, ta.MISALIGNMENT])) == pytest.approx(
            min(degrees, 90.0 - degrees), abs=0.6
        )

    def test_a_disc_is_aligned_however_it_is_turned(self) -> None:
        disc = Parcel(sg.Disc(0.15))
        stream = Stream(Trace((Arrival(0.0, disc, 1.5, "end", None, 0.0, 0.6),)))
        batch = rolled(begun(stream, alignment=0.1), 3.0)
        assert batch.streams.correct[0, 0]

    def test_an_order_is_broken_by_the_one_that_goes_too_early(self) -> None:
        batch = begun(traced((0.0, 1.5), (0.6, 1.5), (1.2, 1.5)), "sequence")
        batch.streams.order[0, :3] = 1, 0, 2
        batch.parcels.goal[0, ORDER] = 1.0  # of the one that has entered
        rolled(batch, 4.0)
        assert batch.streams.correct[0, :3].tolist() == [False, True, True]
        found = batch.task.compute_statistics(batch.streams, 0, False, 1)
        assert found.order_errors == pytest.approx(1.0 / 3.0)


class TestStops:
    STOPS = Stops(run=(1.0, 1.0), stop=(2.0, 2.0), notice=0.4)

    def test_the_belt_moves_while_it_runs(self) -> None:
        batch = begun(traced((0.0, 0.2)), demand=self.STOPS, tilt=0.0)
        moved, shown = [], []
        for _ in range(80):
            batch.step(np.full((1, 64), BRAKE))
            moved.append(batch.streams.memory[0, ta.BELT])
            shown.append(batch.observation[0, 0, ta.COLUMN.takes_away.place])
        assert moved[24] == pytest.approx(2.0, abs=0.02)
        assert moved[74] == pytest.approx(2.0, abs=0.02)
        assert shown[:14] == [1.0] * 14
        assert shown[16:74] == [0.0] * 58  # from the notice on
        assert shown[76:] == [1.0] * 4

    def test_one_that_leaves_while_it_stands_has_left_wrongly(self) -> None:
        batch = rolled(begun(traced((0.0, 2.0)), demand=self.STOPS), 2.4)
        assert batch.streams.taken[0, 0] == 0
        assert not batch.streams.correct[0, 0]

    def test_held_parcels_are_no_jam_while_it_stands(self) -> None:
        batch = begun(traced((0.0, 0.5)), demand=Stops(), patience=1.0)
        batch.streams.memory[0, ta.DEMAND :] = np.inf
        batch.streams.memory[0, ta.DEMAND : ta.DEMAND + 2] = 0.1, 6.0
        rolled(batch, 6.0, BRAKE)
        assert batch.outcome[0] != JAM
        rolled(batch, 1.2, BRAKE)
        assert batch.outcome[0] == JAM


class TestEntering:
    def test_bulk_comes_in_abreast_and_clear_of_all_others(self) -> None:
        batch = begun(bulk(14_000.0))
        abreast = 0
        for _ in range(100):
            batch.step(np.full((1, 64), ROLL))
            here = np.nonzero(batch.streams.present[0])[0]
            fresh = [k for k in here if batch.parcels.clock[k] < 0.1]
            bases = {int(k): corners(batch, int(k)) for k in here}
            abreast += len(fresh) > 1
            for k in fresh:
                for j in here:
                    if j != k:
                        assert distance(bases[int(k)], bases[int(j)]) > -1e-5
        assert abreast > 1


def corners(batch: StreamBatch, k: int) -> np.ndarray:
    """(corners, 2) [m] of the base of a parcel, where it is."""
    x, y, theta = batch.parcels.truth[k, :3]
    outline = batch.bodies.corners[batch.parcels.body[k]]
    cosine, sine = math.cos(theta), math.sin(theta)
    return outline @ np.array([[cosine, sine], [-sine, cosine]]) + [x, y]


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """[m] between two convex bases along the normal of an edge, the greatest; below 0: overlap."""
    found = -math.inf
    for base, beside in ((one, other), (other, one)):
        sides = np.roll(base, -1, axis=0) - base
        for normal in np.stack([sides[:, 1], -sides[:, 0]], axis=-1):
            unit = normal / np.linalg.norm(normal)
            found = max(found, float((beside @ unit).min() - (base @ unit).max()))
    return found


@pytest.mark.parametrize("task", TASKS)
class TestEnvironments:
    def test_observations_rewards_and_ends(self, task: str) -> None:
        env = SmartSurfaceEnv(task, actions="parcels", duration=8.0)
        rng = np.random.default_rng(1)
        observation, info = env.reset(seed=3)
        ended = False
        while not ended:
            assert observation in env.observation_space
            action = rng.integers(0, 4, env.action_space.shape)
            observation, reward, terminated, ended, info = env.step(action)
            assert reward == pytest.approx(
                sum(value for name, value in info.items() if name.startswith("reward_"))
            )
            assert not terminated
        assert info["episode_delivered"] == info["correct"] + info["wrong"]

    def test_rows_say_where_parcels_are(self, task: str) -> None:
        batch = rolled(begun(registration.TASKS[task]().stream, task), 3.0)
        end = batch.config.rotors_end
        for k in np.nonzero(batch.streams.present[0])[0].tolist():
            row, (x, y, theta, vx, vy, omega) = batch.observation[0, k], batch.parcels.truth[k]
            (low_x, low_y), (high_x, high_y) = (
                corners(batch, k).min(axis=0), corners(batch, k).max(axis=0),
            )  # fmt: skip
            shown = dict(zip((each.name for each in ta.FEATURES), row.tolist(), strict=False))
            turned = math.atan2(shown["sine of theta"], shown["cosine of theta"])
            found = {
                "to the end": end - x, "offset": (y - 0.7) / 0.5, "forward speed": vx - 1.0,
                "lateral speed": vy / 0.5, "turning speed": omega / 3.0,
                "front": (high_x - x - 0.2) / 0.1, "rear": (x - low_x - 0.2) / 0.1,
                "left": (high_y - y - 0.2) / 0.1, "right": (y - low_y - 0.2) / 0.1,
            }  # fmt: skip
            assert {name: shown[name] for name in found} == pytest.approx(found, abs=1e-4)
            assert turned == pytest.approx(math.remainder(theta, 2.0 * math.pi), abs=1e-5)


def test_how_long_it_rolls_is_how_long_it_takes() -> None:
    batch = rolled(begun(traced((0.0, 0.8))), 0.2)
    predicted = 4.0 * batch.observation[0, 0, ta.COLUMN.rolling.place] + batch.streams.clock[0]
    rolled(batch, 4.0)
    assert batch.streams.departed[0, 0] == pytest.approx(predicted, abs=0.02)


def test_parcels_of_bulk_are_the_same_for_the_same_seed_and_within_their_sizes() -> None:
    assert bulk_parcels(5) == bulk_parcels(9)[:5]
    assert bulk_parcels(3, seed=1) != bulk_parcels(3)
    for each in bulk_parcels(40):
        assert 0.2 <= each.base.length <= 0.45
        assert 0.2 <= each.base.width <= 0.4


@pytest.mark.parametrize(
    ("task", "arguments", "message"),
    [
        ("singulate", {"exits": "sides"}, "exits must all lie straight on, got 'left' to a side"),
        ("singulate", {"take_away": 0.0}, "take_away must be"),
        ("singulate", {"gap": -0.1}, "gap must be"),
        ("singulate", {"alignment": 10.0}, "alignment must be"),
        ("singulate", {"demand": 3.0}, "demand must be Stops, or None, got 3.0"),
        ("singulate", {"exits": (Exit("x", 0, 3.0, 4.0),)}, "exits straight on must lie across"),
        ("merge", {"inlets": (Inlet("one"),)}, "inlets must be at least two to merge, got 1"),
        ("sequence", {"stream": Stream(window=65)}, "window must be a whole number of at most 64"),
    ],
)
def test_bad_arguments_are_named(task: str, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        EnvConfig(task, **arguments)


@pytest.mark.parametrize("bad", [{"run": (0.0, 1.0)}, {"stop": (3.0, 2.0)}, {"notice": -1.0}])
def test_bad_stops_are_named(bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        Stops(**bad)


def test_an_index_out_of_bounds_is_told_with_the_sizes_of_all_arrays(monkeypatch) -> None:
    def step_beyond(*_: object) -> None:
        raise IndexError

    batch = StreamBatch(EnvConfig("singulate", actions="parcels"), 1)
    batch.seed(0, np.random.default_rng(0))
    monkeypatch.setattr(batch._workers, "run", step_beyond)
    with pytest.raises(ValueError, match=r"^Singulate with Exact must .* 2 results, .* memories:"):
        batch.reset(np.arange(1))
