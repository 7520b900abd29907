"""Parcels leave where no rotor bears them any more, by the exit that is there, or between exits."""

import math
from typing import Any

import numpy as np
import pytest

from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.exits import Exit, Exits, chutes, flow_line, sides
from surface_gym.flow.state import BETWEEN, LEFT_RIGHT, LEFT_WRONG, ON_ITS_WAY, RIGHT, WRONG
from surface_gym.physics.types import X, Y
from tests.flow.flows import (
    BOX,
    BRAKE,
    MINUS_45,
    PLUS_45,
    ROLL,
    SHORT,
    bare,
    batch_with,
    box_of,
    play,
    set_down,
    trace,
)

OWN = Exits((Exit("a", 1, 0.3, 0.8), Exit("b", -1, 1.0), Exit("c", 1, 1.5, 1.9)))


class TestPlaces:
    @pytest.mark.parametrize(
        "exits", [chutes(2.0), sides(2.0), OWN], ids=["chutes", "sides", "own, none straight on"]
    )
    def test_the_rule_is_that_of_exits(self, exits: Exits) -> None:
        """Wherever a parcel is put down beside the rotors, it has left by the exit there."""
        rng = np.random.default_rng(1)
        seen = set()
        for _ in range(6):
            batch = batch_with(trace(*[(0.0, exits.names[0])] * 20), exits=exits, duration=9.0)
            x = rng.uniform(0.2, 2.5, 20)
            y = rng.choice([-1.0, 1.0], 20) * rng.uniform(0.35, 0.8, 20) + SHORT.line_y
            set_down(batch, np.column_stack([x, y, rng.uniform(-3.0, 3.0, 20)]))
            batch.step(np.full((1, batch.config.action_kind.size), BRAKE))
            streams, parcels = batch.streams, batch.parcels
            for place in range(20):
                truth = parcels.truth[place]
                assert not streams.present[0, place]
                # No rotor bears it from x = 1.95 on, the last column: it is straight on.
                rear = box_of(BOX, truth[:3])[0]
                straight = rear > 1.95 or truth[X] > 2.0
                side = 0 if straight else int(math.copysign(1, truth[Y] - SHORT.line_y))
                wanted = exits.at(side, truth[X])
                assert streams.taken[0, place] == wanted
                right = wanted == 0
                assert parcels.outcome[place] == (LEFT_RIGHT if right else LEFT_WRONG)
                assert 0.0 < streams.left[0, place] <= 0.04
                seen.add(wanted)
            taken = streams.taken[0, :20]
            assert streams.tally[0, RIGHT] == (taken == 0).sum()
            assert streams.tally[0, WRONG] == (taken != 0).sum()
        assert seen == {*range(len(exits)), BETWEEN} or exits is not OWN

    def test_on_rotors_it_stays(self) -> None:
        batch = batch_with(trace(*[(0.0, "left 1")] * 3), duration=9.0)
        set_down(batch, [(0.5, 1.0, 0.2), (1.0, 1.27, 0.0), (1.9, 0.9, 0.0)])
        batch.step(np.full((1, batch.config.action_kind.size), BRAKE))
        assert batch.streams.present[0, :3].all()
        assert (batch.streams.taken[0, :3] == ON_ITS_WAY).all()
        assert np.isnan(batch.streams.left[0, :3]).all()


def sent(choice: int, asked: str, exits: Any = "chutes") -> tuple[SmartSurfaceEnv, dict[str, Any]]:
    """One parcel over modules that are all alike, and the info of its end."""
    env = bare(stream=trace((0.0, asked)), exits=exits, duration=4.0, line=flow_line(3.0))
    return env, play(env, choice)[-1][4]


class TestWays:
    @pytest.mark.parametrize(
        ("choice", "asked", "taken"),
        [
            (MINUS_45, "left 1", "left 1"),
            (PLUS_45, "right 1", "right 1"),
            (MINUS_45, "left 2", "left 1"),
            (MINUS_45, "right 1", "left 1"),
            (ROLL, "straight", "straight"),
            (ROLL, "left 1", "straight"),
            (MINUS_45, "straight", "left 1"),
        ],
    )
    def test_outcomes(self, choice: int, asked: str, taken: str) -> None:
        env, info = sent(choice, asked)
        streams = env.batch.streams
        exits = env.config.exits
        assert streams.taken[0, 0] == exits.place(taken)
        assert (info["right"], info["wrong"]) == ((1, 0) if asked == taken else (0, 1))
        assert streams.left[0, 0] > streams.entered[0, 0]
        assert info["parcels"].tolist() == [-1] * 24

    def test_between_exits_is_wrong(self) -> None:
        x = float(sent(MINUS_45, "left 1")[0].batch.parcels.truth[0, X])
        around = Exits((Exit("here", 1, x - 1e-6, x + 1e-6), Exit("other", -1)))
        beside = Exits((Exit("here", 1, x + 1e-6, x + 1.0), Exit("before", 1, 0.0, x - 1e-6)))
        env, info = sent(MINUS_45, "here", around)
        assert env.batch.streams.taken[0, 0] == 0
        assert info["right"] == 1
        env, info = sent(MINUS_45, "here", beside)
        assert env.batch.streams.taken[0, 0] == BETWEEN
        assert info["wrong"] == 1

    def test_straight_on_without_an_exit_is_between(self) -> None:
        env, info = sent(ROLL, "left", Exits((Exit("left", 1), Exit("right", -1))))
        assert env.batch.streams.taken[0, 0] == BETWEEN
        assert info["wrong"] == 1

    def test_straight_on_it_leaves_with_its_rear_past_the_last_rotors(self) -> None:
        env, _ = sent(ROLL, "straight")
        truth = env.batch.parcels.truth[0]
        rear = truth[X] - 0.125
        assert 2.95 < rear < 2.95 + 1.6 * 0.005 + 1e-6  # within a physics step

    def test_its_place_is_free_from_the_next_decision_on(self) -> None:
        stream = trace((0.0, "straight"), (0.0, "straight"))
        batch: StreamBatch = batch_with(stream, max_parcels=2, duration=9.0)
        set_down(batch, [(2.07, 1.0, 0.0), (0.5, 1.0, 0.0)], [(1.0, 0.0, 0.0), (0.1, 0.0, 0.0)])
        roll = np.full((1, batch.config.action_kind.size), ROLL)
        batch.step(roll)
        assert batch.streams.number[0].tolist() == [0, 1]
        assert batch.streams.present[0].tolist() == [False, True]
        assert not batch.observation[0, 0].any()
        assert batch.parcels.reward[0] > 0.9
        batch.step(roll)
        assert batch.streams.number[0].tolist() == [-1, 1]
        assert batch.parcels.reward[0] == 0.0
