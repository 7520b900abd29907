"""Parcels come onto the line in order, as soon as their time has come and there is room; they leave
where no rotor bears them any more, by the exit that is there, or between exits.
"""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow import state as fs
from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.exits import Exit, Exits, chutes, flow_line, sides
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import COLUMN
from surface_gym.physics.types import THETA, Array, X, Y
from surface_gym.randomisation import Randomisation
from tests.flow import flows

DT = 0.005  # [s] also the control period: every physics step is seen
RUSH = Stream(Poisson(20000.0, 0.05), parcels=("S", "B"), speeds=(0.8, 1.6))


def rush(**settings: Any) -> StreamBatch:
    settings = {"stream": RUSH, "control_period": DT, "duration": 2.0, **settings}
    return flows.batch_with(**settings)


def poses(batch: StreamBatch) -> dict[int, Array]:
    present = np.nonzero(batch.streams.present[0])[0]
    return {int(place): batch.parcels.truth[place, : THETA + 1].copy() for place in present}


def clear(
    batch: StreamBatch, parcel: sg.Parcel, pose: Array, others: dict[int, Array], gap: float
) -> bool:
    """Whether the box of a parcel at a pose, with a gap around and ahead, is free of others."""
    _, front, right, left = flows.box_of(parcel, pose)
    boxes = (flows.box_of(batch.parcel(0, other), its) for other, its in others.items())
    return all(
        rear > front + gap or low >= left + gap or high <= right - gap
        for rear, _, low, high in boxes
    )


class TestRoom:
    @pytest.mark.parametrize(
        "settings",
        [
            {}, {"entry_gap": 0.2}, {"entry_gap": 0.0}, {"max_parcels": 2}, {"max_parcels": 1},
            {"randomisation": Randomisation(lateral=0.15, heading=0.1)},
        ],
        ids=repr,
    )  # fmt: skip
    def test_enters_at_the_first_step_with_room_and_a_place(self, settings: Any) -> None:
        batch = rush(**settings, duration=7.0)
        gap = batch.config.stream_task.entry_gap
        entered = barred = full = 0
        for step in range(1200):
            streams = batch.streams
            waiting = int((streams.time[0, : streams.arrivals[0]] <= streams.clock[0] + DT).sum())
            waiting -= int(streams.coming[0])
            held = (streams.number[0] != fs.NOBODY) & streams.present[0]
            before = int(streams.coming[0])
            batch.step(flows.command(batch, flows.ROLL if step < 1050 else flows.BRAKE))
            streams, now = batch.streams, poses(batch)
            if streams.coming[0] > before:
                assert streams.coming[0] == before + 1
                (place,) = np.nonzero(streams.present[0] & (streams.number[0] == before))[0]
                others = {at: pose for at, pose in now.items() if at != place}
                assert clear(batch, batch.parcel(0, place), now[place], others, gap)
                assert streams.entered[0, before] == streams.clock[0]
                assert streams.entered[0, before] >= streams.time[0, before]
                rear = flows.box_of(batch.parcel(0, place), now[place])[0]
                assert rear == pytest.approx(0.0, abs=1e-12)
                entered += 1
            elif waiting > 0:
                if held.all():  # a place is kept until the decision after its parcel left
                    full += 1
                else:
                    parcel = batch._pool.parcel(int(streams.body[0, before]))
                    assert not clear(batch, parcel, streams.start[0, before, :3], now, gap), step
                    barred += 1
        assert entered >= 2
        assert barred + full > 100
        assert full > 0 or batch.task.max_parcels > 2

    def test_nobody_is_dropped_and_order_is_kept(self) -> None:
        batch = rush()
        streams = batch.streams
        waited, place_of = 0.0, dict[int, int]()
        for _ in range(390):
            waited += DT * int(streams.due[0] - streams.coming[0])
            batch.step(flows.command(batch, flows.ROLL))
            streams = batch.streams
            time = streams.time[0, : streams.arrivals[0]]
            due = int((time <= streams.clock[0]).sum())
            entered = int(streams.coming[0])
            assert streams.due[0] == due
            assert streams.tally[0, 0] == entered <= due
            assert not np.isnan(streams.entered[0, :entered]).any()
            assert np.isnan(streams.entered[0, entered:]).all()
            assert streams.waited[0] == pytest.approx(waited)
            for place in poses(batch):  # kept while its parcel is there
                assert place_of.setdefault(int(streams.number[0, place]), place) == place
        assert (np.diff(streams.entered[0, :entered]) > 0.0).all()
        late = np.maximum(streams.clock[0], 0.0) - time[entered:due]
        most = max((streams.entered[0, :entered] - time[:entered]).max(), late.max())
        found = fs.compute_statistics(streams, 0, jammed=False, obeying=1)
        assert found.waiting_most == pytest.approx(most)
        # Each that waits adds to the sum what it has waited, but for a step's round-off.
        each = np.concatenate([streams.entered[0, :entered] - time[:entered], late])
        assert waited == pytest.approx(each.sum(), abs=DT * len(each))


class TestGate:
    def gated(self, *times: float, **settings: Any) -> StreamBatch:
        stream = flows.trace(*[(time, "straight") for time in times])
        settings = {"gate": True, "actions": "parcels", "duration": 4.0, **settings}
        return flows.batch_with(stream, **settings)

    def step(self, batch: StreamBatch, opens: int) -> None:
        action = flows.command(batch, flows.ROLL)
        action[0, -1] = opens
        batch.step(batch.config.action_kind.commands(action, 1))

    def test_shut_it_lets_nobody_in(self) -> None:
        batch = self.gated(0.0, 0.1)
        for _ in range(20):
            self.step(batch, 0)
            assert not batch.streams.present.any()
        assert batch.streams.due[0] == 2
        # They are counted as due in the physics step in which their time comes.
        assert batch.streams.waited[0] == pytest.approx(0.8 + 0.7, abs=2 * DT)

    @pytest.mark.parametrize("opens", [1, 3, 8])
    def test_opened_it_lets_one_in_from_that_step_on(self, opens: int) -> None:
        batch = self.gated(0.0, 0.0)
        self.step(batch, opens)
        assert batch.streams.coming[0] == 1
        assert batch.streams.entered[0, 0] == pytest.approx(opens * DT)

    def test_the_last_row_is_who_enters_next(self) -> None:
        batch = self.gated(0.0, 0.5)
        waits = batch.observation[0, -1].copy()
        assert waits[COLUMN.present.place] == waits[COLUMN.waits.place] == 1.0
        assert waits[12] == 0.0
        self.step(batch, 0)
        assert batch.observation[0, -1, 12] == pytest.approx(-0.04 / 4.0)
        self.step(batch, 8)
        np.testing.assert_array_equal(batch.observation[0, 0, :12], waits[:12])
        assert batch.observation[0, 0, COLUMN.waits.place] == 0.0
        assert not batch.observation[0, -1].any()  # the second's time has yet to come

    def test_an_open_one_equals_none_as_long_as_one_at_a_time_comes(self) -> None:
        batch, free = (self.gated(0.0, 0.41, 0.92, gate=gate) for gate in (True, False))
        for _ in range(61):
            self.step(batch, 1)
            free.step(flows.command(free, flows.ROLL))
        np.testing.assert_array_equal(batch.streams.entered[0, 1:3], free.streams.entered[0, 1:3])

    @pytest.mark.parametrize(
        "action", [[3] * 48 + [9], [3] * 48 + [-1], [3] * 48, [[3, 3], 1], [3.0] * 49], ids=repr
    )
    def test_bad_actions_are_named(self, action: Any) -> None:
        batch = self.gated(0.0)
        with pytest.raises(ValueError, match="action"):
            batch.config.action_kind.commands([action], 1)


OWN = Exits((Exit("a", 1, 0.3, 0.8), Exit("b", -1, 1.0), Exit("c", 1, 1.5, 1.9)))


class TestPlaces:
    @pytest.mark.parametrize(
        "exits", [chutes(2.0), sides(2.0), OWN], ids=["chutes", "sides", "own, none straight on"]
    )
    def test_the_rule_is_that_of_exits(self, exits: Exits) -> None:
        rng = np.random.default_rng(1)
        seen = set()
        for _ in range(6):
            batch = flows.batch_with(
                flows.trace(*[(0.0, exits.names[0])] * 20), exits=exits, duration=9.0
            )
            x = rng.uniform(0.2, 2.5, 20)
            y = rng.choice([-1.0, 1.0], 20) * rng.uniform(0.35, 0.8, 20) + flows.SHORT.line_y
            flows.set_down(batch, np.column_stack([x, y, rng.uniform(-3.0, 3.0, 20)]))
            batch.step(flows.command(batch, flows.BRAKE))
            streams, parcels = batch.streams, batch.parcels
            for place in range(20):
                truth = parcels.truth[place]
                assert not streams.present[0, place]
                # No rotor bears it from x = 1.95 on, the last column: it is straight on.
                rear = flows.box_of(flows.BOX, truth[:3])[0]
                straight = rear > 1.95 or truth[X] > 2.0
                side = 0 if straight else int(math.copysign(1, truth[Y] - flows.SHORT.line_y))
                holds = [each.side == side and each.first <= truth[X] < each.last for each in exits]
                wanted = holds.index(True) if any(holds) else fs.BETWEEN
                assert streams.taken[0, place] == wanted
                assert parcels.outcome[place] == (
                    fs.DEPARTED_WRONG if wanted else fs.DEPARTED_CORRECT
                )
                assert 0.0 < streams.departed[0, place] <= 0.04
                seen.add(wanted)
            right = int((streams.taken[0, :20] == 0).sum())
            assert streams.tally[0, [fs.CORRECT, fs.WRONG]].tolist() == [right, 20 - right]
        assert seen == {*range(len(exits)), fs.BETWEEN} or exits is not OWN

    def test_on_rotors_it_stays(self) -> None:
        batch = flows.batch_with(flows.trace(*[(0.0, "left 1")] * 3), duration=9.0)
        flows.set_down(batch, [(0.5, 1.0, 0.2), (1.0, 1.27, 0.0), (1.9, 0.9, 0.0)])
        batch.step(flows.command(batch, flows.BRAKE))
        assert batch.streams.present[0, :3].all()
        assert (batch.streams.taken[0, :3] == fs.ON_ITS_WAY).all()
        assert np.isnan(batch.streams.departed[0, :3]).all()


def sent(choice: int, asked: str, exits: Any = "chutes") -> tuple[SmartSurfaceEnv, dict[str, Any]]:
    """One parcel over modules that are all alike, and the info of its end."""
    env = flows.bare(
        stream=flows.trace((0.0, asked)), exits=exits, duration=4.0, line=flow_line(3.0)
    )
    return env, flows.play(env, choice)[-1][4]


class TestWays:
    @pytest.mark.parametrize(
        ("choice", "asked", "taken"),
        [
            (flows.MINUS_45, "left 1", "left 1"), (flows.PLUS_45, "right 1", "right 1"),
            (flows.MINUS_45, "left 2", "left 1"), (flows.MINUS_45, "right 1", "left 1"),
            (flows.ROLL, "straight", "straight"), (flows.ROLL, "left 1", "straight"),
            (flows.MINUS_45, "straight", "left 1"),
        ],
    )  # fmt: skip
    def test_outcomes(self, choice: int, asked: str, taken: str) -> None:
        env, info = sent(choice, asked)
        streams = env.batch.streams
        assert streams.taken[0, 0] == env.config.exits.place(taken)
        assert (info["correct"], info["wrong"]) == ((1, 0) if asked == taken else (0, 1))
        assert streams.departed[0, 0] > streams.entered[0, 0]
        assert info["parcels"].tolist() == [-1] * 24
        if taken == "straight":  # its rear past the last rotors, within a physics step
            rear = env.batch.parcels.truth[0, X] - 0.125
            assert 2.95 < rear < 2.95 + 1.6 * DT + 1e-6

    def test_between_exits_is_wrong(self) -> None:
        x = sent(flows.MINUS_45, "left 1")[0].batch.parcels.truth[0, X].item()
        around = Exits((Exit("here", 1, x - 1e-6, x + 1e-6), Exit("other", -1)))
        beside = Exits((Exit("here", 1, x + 1e-6, x + 1.0), Exit("before", 1, 0.0, x - 1e-6)))
        env, info = sent(flows.MINUS_45, "here", around)
        assert env.batch.streams.taken[0, 0] == 0
        assert info["correct"] == 1
        # Also straight on where that is no exit.
        for choice, exits in ((flows.MINUS_45, beside), (flows.ROLL, Exits((Exit("here", 1),)))):
            env, info = sent(choice, "here", exits)
            assert env.batch.streams.taken[0, 0] == fs.BETWEEN
            assert info["wrong"] == 1

    def test_its_place_is_free_from_the_next_decision_on(self) -> None:
        stream = flows.trace((0.0, "straight"), (0.0, "straight"))
        batch = flows.batch_with(stream, max_parcels=2, duration=9.0)
        flows.set_down(
            batch, [(2.07, 1.0, 0.0), (0.5, 1.0, 0.0)], [(1.0, 0.0, 0.0), (0.1, 0.0, 0.0)]
        )
        batch.step(flows.command(batch, flows.ROLL))
        assert batch.streams.number[0].tolist() == [0, 1]
        assert batch.streams.present[0].tolist() == [False, True]
        assert not batch.observation[0, 0].any()
        assert batch.parcels.reward[0] > 0.9
        batch.step(flows.command(batch, flows.ROLL))
        assert batch.streams.number[0].tolist() == [-1, 1]
        assert batch.parcels.reward[0] == 0.0
