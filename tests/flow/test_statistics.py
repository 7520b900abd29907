"""What an episode comes to: an example by hand, and played ones counted again from their steps."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest

from surface_gym.flow import state as fs
from surface_gym.randomisation import Randomisation
from tests.flow.flows import MINUS_45, ROLL, bare, same_choice

NAN = math.nan


def recorded(clock: float, *rows: tuple[float, ...], turns: int = 0) -> fs.StreamState:
    """A surface on which parcels came [s], entered [s] and left [s], were to leave by an exit, took
    one, and touched others so often.
    """
    obeys = np.ones((1, 2, 2), dtype=bool)
    streams = fs.with_room(fs.make_streams(1, 2, (2, 2), 7, obeys), len(rows))
    columns = ("time", "entered", "departed", "exit", "taken", "touches")
    for name, values in zip(columns, zip(*rows, strict=True), strict=True):
        getattr(streams, name)[0, : len(rows)] = values
    streams.correct[0] = streams.taken[0] == streams.exit[0]
    streams.arrivals[0] = len(rows)
    streams.clock[0] = clock
    streams.tally[0, fs.TURNS] = turns
    return streams


BY_HAND = recorded(
    36.0,
    (0.0, 0.0, 4.0, 0, 0, 0),
    (1.0, 1.0, 6.0, 1, 0, 1),  # by another's exit
    (2.0, 4.0, 10.0, 0, 0, 1),
    (3.0, 6.0, 9.0, 2, fs.BETWEEN, 2),
    (20.0, 21.0, 30.0, 2, 2, 0),
    (30.0, 33.0, NAN, 0, fs.ON_ITS_WAY, 2),
    (32.0, NAN, NAN, 1, fs.ON_ITS_WAY, 0),  # waits still
    (40.0, NAN, NAN, 1, fs.ON_ITS_WAY, 0),  # has yet to come
    turns=80,
)


class TestByHand:
    def test_of_a_whole_episode(self) -> None:
        found = fs.compute_statistics(BY_HAND, 0, jammed=True, obeying=4)
        assert found.delivered == 5
        assert found.parcels_per_hour == pytest.approx(3 * 100.0)
        assert found.missort_rate == pytest.approx(2 / 5)
        assert found.touches_per_1000 == pytest.approx(2 * 200.0)
        assert found.jams_per_1000 == pytest.approx(200.0)
        # The first exit was left by at 4, 6 and 10 s, the others once each.
        assert found.gap_mean == pytest.approx(3.0)
        assert found.gap_5 == pytest.approx(2.1)
        assert found.gap_spread == pytest.approx(1.0)
        assert found.time_mean == pytest.approx((4 + 5 + 6 + 3 + 9) / 5)
        assert found.time_95 == pytest.approx(6 + 0.8 * 3)
        assert found.waiting_mean == pytest.approx((0 + 0 + 2 + 3 + 1 + 3) / 6)
        assert found.waiting_most == pytest.approx(4.0)
        assert found.turns_per_hour == pytest.approx(80 / 4 * 100.0)

    def test_after_a_warm_up(self) -> None:
        found = fs.compute_statistics(BY_HAND, 0, jammed=False, obeying=4, warm_up=6.0)
        assert found.delivered == 4
        assert found.parcels_per_hour == pytest.approx(2 * 120.0)
        assert found.missort_rate == pytest.approx(1 / 2)
        assert found.jams_per_1000 == 0.0
        assert found.gap_mean == pytest.approx(4.0)
        assert found.waiting_mean == pytest.approx((1 + 3) / 2)
        assert found.waiting_most == pytest.approx(4.0)

    def test_where_nothing_happened(self) -> None:
        nothing = recorded(0.0, (1.0, NAN, NAN, 0, fs.ON_ITS_WAY, 0))
        found = fs.compute_statistics(nothing, 0, jammed=False, obeying=0)
        assert found.delivered == 0
        for name in [each.name for each in dataclasses.fields(found)][1:]:
            assert math.isnan(getattr(found, name)), name


@pytest.mark.parametrize("varied", [{}, {"lateral": 0.02, "heading": 0.05}])
@pytest.mark.parametrize("seed", [0, 1])
def test_played_episodes_come_to_what_their_steps_tell(seed: int, varied: dict[str, Any]) -> None:
    randomisation = Randomisation(**varied)
    period = 0.005  # one physics step: nothing happens between two looks
    env = bare(actions="modules", duration=5.0, control_period=period, randomisation=randomisation)
    env.reset(seed=seed)
    asked = env.batch.streams.exit[0].tolist()
    entered: dict[int, float] = {0: 0.0}
    left: dict[int, float] = {}
    turns = right = 0
    commanded = env.batch.streams.commanded[0].copy()
    info: dict[str, Any] = {}
    for step in itertools.count():
        if info and info["outcome"] != "running":
            break
        *_, info = env.step(same_choice(env, MINUS_45 if (step // 80) % 3 else ROLL))
        now = {number for number in info["parcels"].tolist() if number >= 0}
        streams = env.batch.streams
        for number in now - set(entered):
            entered[number] = info["time"]
        for number in set(entered) - set(left) - now:
            left[number] = info["time"]
            right += int(streams.taken[0, number]) == asked[number]
        turns += int((np.abs(streams.commanded[0] - commanded) > 1e-9).sum())
        commanded = streams.commanded[0].copy()
        assert (info["correct"], info["wrong"], info["turns"]) == (right, len(left) - right, turns)
    for kept, seen in ((streams.entered, entered), (streams.departed, left)):
        assert len(seen) >= 3
        numbers = np.nonzero(~np.isnan(kept[0]))[0].tolist()
        assert {number: kept[0, number] for number in numbers} == pytest.approx(seen)
    found = fs.compute_statistics(streams, 0, jammed=False, obeying=4 * 15)
    figures = {name: info[f"episode_{name}"] for name in vars(found)}
    assert figures == pytest.approx(dataclasses.asdict(found), nan_ok=True)
    assert figures["turns_per_hour"] == pytest.approx(3600.0 * turns / (4 * 15 * info["time"]))
    # Of who touched whom only those that have left count, each for its half.
    assert figures["touches_per_1000"] <= 1000.0 * info["touches"] / len(left)
