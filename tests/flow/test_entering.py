"""Parcels come onto the line in order, as soon as their time has come and there is room."""

from typing import Any

import numpy as np
import pytest

from surface_gym.flow.arrivals import Poisson, Steady
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import NOBODY, compute_statistics
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import PRESENT, WAITS
from surface_gym.physics.types import THETA, Array
from surface_gym.randomisation import Randomisation
from tests.flow.flows import BRAKE, DENSE, ROLL, batch_with, box_of, parcel_of, trace

DT = 0.005  # [s] also the control period: every physics step is seen
RUSH = Stream(Poisson(20000.0, 0.05), parcels=("S", "B"), speeds=(0.8, 1.6))


def rush(**settings: Any) -> StreamBatch:
    """More parcels than can enter, a control period a physics step."""
    settings = {"stream": RUSH, "control_period": DT, "duration": 2.0, **settings}
    return batch_with(**settings)


def command(batch: StreamBatch, choice: int) -> Array:
    return np.full((1, batch.config.action_kind.size), choice)


def poses(batch: StreamBatch) -> dict[int, Array]:
    """Of who is there, by place."""
    present = np.nonzero(batch.streams.present[0])[0]
    return {int(place): batch.parcels.truth[place, : THETA + 1].copy() for place in present}


def clear(batch: StreamBatch, place: int, others: dict[int, Array], gap: float) -> bool:
    """Whether the box of the parcel of a place, with a gap around and ahead, is free of others."""
    _, front, right, left = box_of(parcel_of(batch, place), poses(batch)[place])
    for other, pose in others.items():
        rear, _, other_right, other_left = box_of(parcel_of(batch, other), pose)
        beside = other_right >= left + gap or other_left <= right - gap
        if rear <= front + gap and not beside:
            return False
    return True


def next_clear(batch: StreamBatch, others: dict[int, Array], gap: float) -> bool:
    """Whether the next to enter would find room."""
    streams = batch.streams
    arrival = int(streams.coming[0])
    parcel = batch._pool.parcel(int(streams.body[0, arrival]))
    place = int(np.nonzero(streams.number[0] == NOBODY)[0][0])
    batch.parcels.body[place] = streams.body[0, arrival]
    start = np.array([*streams.start[0, arrival, : THETA + 1]])
    _, front, right, left = box_of(parcel, start)
    return all(
        rear > front + gap or low >= left + gap or high <= right - gap
        for rear, _, low, high in (
            box_of(parcel_of(batch, other), pose) for other, pose in others.items()
        )
    )


class TestRoom:
    @pytest.mark.parametrize(
        "settings",
        [
            {},
            {"entry_gap": 0.2},
            {"entry_gap": 0.0},
            {"max_parcels": 2},
            {"max_parcels": 1},
            {"randomisation": Randomisation(lateral=0.15, heading=0.1)},
        ],
        ids=repr,
    )
    def test_enters_at_the_first_step_with_room_and_a_place(self, settings: Any) -> None:
        batch = rush(**settings, duration=7.0)
        gap = batch.config.stream_task.entry_gap
        streams = batch.streams
        entered = barred = full = 0
        for step in range(1200):
            waiting = int((streams.time[0, : streams.arrivals[0]] <= streams.clock[0] + DT).sum())
            waiting -= int(streams.coming[0])
            held = (streams.number[0] != NOBODY) & streams.present[0]
            before = int(streams.coming[0])
            batch.step(command(batch, ROLL if step < 1050 else BRAKE))
            streams = batch.streams
            now = poses(batch)
            if streams.coming[0] > before:
                assert streams.coming[0] == before + 1
                (place,) = np.nonzero(streams.present[0] & (streams.number[0] == before))[0]
                others = {at: pose for at, pose in now.items() if at != place}
                assert clear(batch, place, others, gap)
                assert streams.entered[0, before] == streams.clock[0]
                assert streams.entered[0, before] >= streams.time[0, before]
                rear = box_of(parcel_of(batch, place), now[place])[0]
                assert rear == pytest.approx(0.0, abs=1e-12)
                entered += 1
            elif waiting > 0:
                if held.all():  # a place is kept until the decision after its parcel left
                    full += 1
                else:
                    assert not next_clear(batch, now, gap), step
                    barred += 1
        assert entered >= 2
        assert barred + full > 100
        assert full > 0 or batch.task.max_parcels > 2

    def test_nobody_is_dropped_and_order_is_kept(self) -> None:
        batch = rush()
        streams = batch.streams
        waited = 0.0
        for _ in range(390):
            waited += DT * int(streams.due[0] - streams.coming[0])
            batch.step(command(batch, ROLL))
            streams = batch.streams
            time = streams.time[0, : streams.arrivals[0]]
            due = int((time <= streams.clock[0]).sum())
            entered = int(streams.coming[0])
            assert streams.due[0] == due
            assert streams.tally[0, 0] == entered <= due
            assert not np.isnan(streams.entered[0, :entered]).any()
            assert np.isnan(streams.entered[0, entered:]).all()
            assert streams.waited[0] == pytest.approx(waited)
        assert (np.diff(streams.entered[0, :entered]) > 0.0).all()
        late = np.maximum(streams.clock[0], 0.0) - time[entered:due]
        most = max((streams.entered[0, :entered] - time[:entered]).max(), late.max())
        found = compute_statistics(streams, 0, jammed=False, obeying=1)
        assert found.waiting_most == pytest.approx(most)
        # Each that waits adds to the sum what it has waited, but for a step's round-off.
        each = np.concatenate([streams.entered[0, :entered] - time[:entered], late])
        assert waited == pytest.approx(each.sum(), abs=DT * len(each))

    def test_alone_nobody_waits(self) -> None:
        """At a gap of 3 s each enters in the first physics step after its time."""
        batch = batch_with(Stream(Steady(1200.0)), duration=9.5)
        while batch.streams.outcome[0] == 0:
            batch.step(command(batch, ROLL))
        np.testing.assert_allclose(
            batch.streams.entered[0, :4], [0.0, 3.0, 6.0, 9.0], atol=DT + 1e-9
        )
        assert (batch.streams.entered[0, :4] >= batch.streams.time[0, :4]).all()
        assert batch.streams.waited[0] == 0.0

    def test_a_place_is_kept_while_its_parcel_is_there(self) -> None:
        batch = batch_with(DENSE, duration=3.0)
        place_of: dict[int, int] = {}
        for _ in range(74):
            batch.step(command(batch, ROLL))
            for place in np.nonzero(batch.streams.present[0])[0].tolist():
                number = int(batch.streams.number[0, place])
                assert place_of.setdefault(number, place) == place
        assert len(place_of) > 4


class TestGate:
    def gated(self, *times: float, **settings: Any) -> StreamBatch:
        stream = trace(*[(time, "straight") for time in times])
        return batch_with(stream, gate=True, duration=4.0, **{"actions": "parcels", **settings})

    def command(self, batch: StreamBatch, opens: int) -> Array:
        action = command(batch, ROLL)
        action[0, -1] = opens
        return batch.config.action_kind.commands(action, 1)

    def test_shut_it_lets_nobody_in(self) -> None:
        batch = self.gated(0.0, 0.1)
        for _ in range(20):
            batch.step(self.command(batch, 0))
            assert not batch.streams.present.any()
        assert batch.streams.due[0] == 2
        # They are counted as due in the physics step in which their time comes.
        assert batch.streams.waited[0] == pytest.approx(0.8 + 0.7, abs=2 * DT)

    @pytest.mark.parametrize("opens", [1, 3, 8])
    def test_opened_it_lets_one_in_from_that_step_on(self, opens: int) -> None:
        batch = self.gated(0.0, 0.0)
        batch.step(self.command(batch, opens))
        assert batch.streams.coming[0] == 1
        assert batch.streams.entered[0, 0] == pytest.approx(opens * DT)

    def test_the_last_row_is_who_enters_next(self) -> None:
        batch = self.gated(0.0, 0.5)
        waits = batch.observation[0, -1].copy()
        assert waits[PRESENT] == waits[WAITS] == 1.0
        assert waits[12] == 0.0
        batch.step(self.command(batch, 0))
        assert batch.observation[0, -1, 12] == pytest.approx(-0.04 / 4.0)
        batch.step(self.command(batch, 8))
        np.testing.assert_array_equal(batch.observation[0, 0, :12], waits[:12])
        assert batch.observation[0, 0, WAITS] == 0.0
        assert not batch.observation[0, -1].any()  # the second's time has yet to come

    def test_an_open_one_equals_none_as_long_as_one_at_a_time_comes(self) -> None:
        batch, free = self.gated(0.0, 0.41, 0.92), batch_with(
            trace(*[(time, "straight") for time in (0.0, 0.41, 0.92)]),
            duration=4.0, actions="parcels",
        )  # fmt: skip
        free_action = command(free, ROLL)
        batch.step(self.command(batch, 1))
        free.step(free_action)
        for _ in range(60):
            batch.step(self.command(batch, 1))
            free.step(free_action)
        np.testing.assert_array_equal(batch.streams.entered[0, 1:3], free.streams.entered[0, 1:3])

    @pytest.mark.parametrize(
        "action", [[3] * 48 + [9], [3] * 48 + [-1], [3] * 48, [[3, 3], 1], [3.0] * 49], ids=repr
    )
    def test_bad_actions_are_named(self, action: Any) -> None:
        batch = self.gated(0.0)
        with pytest.raises(ValueError, match="action"):
            batch.config.action_kind.commands([action], 1)
