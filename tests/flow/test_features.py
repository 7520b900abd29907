"""The table of a flow, row by row from the parcels' poses."""

import math
from typing import Any

import numpy as np
import pytest

from surface_gym.flow.arrivals import Poisson, Steady
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import AHEAD, BEHIND, COLUMN, FEATURES
from surface_gym.physics.types import Array
from surface_gym.randomisation import Actuators
from surface_gym.sensors import Camera
from surface_gym.tasks.sort import FEATURES as SORT_FEATURES
from tests.environments import assert_same
from tests.flow.flows import KINDS, ROLL, SHORT, bare, box_of

NAMES = [feature.name for feature in FEATURES]
FIRST_OF_ZONE = 0.5  # [m] after a lead-in of 5 columns
CROWD = Stream(Steady(9000.0), parcels=("S", "B"), speeds=(1.0, 1.4))
ROTORS = 0.15  # [m] from the middle to the outer rotors' centres


def neighbour(batch: StreamBatch, place: int, other: int | None, ahead: bool, flip: float) -> list:
    """Gap, speed, offset, side and size of the next one; of nobody, if there is none."""
    if other is None:
        return [8.0, 0.0, 0.0, 0.0, 0.0]
    own, its = batch.parcels.sensed[place], batch.parcels.sensed[other]
    rear, front, _, _ = box_of(batch.parcel(0, place), own[:3])
    its_rear, its_front, _, _ = box_of(batch.parcel(0, other), its[:3])
    gap = its_rear - front if ahead else rear - its_front
    exits = batch.config.exits.exits
    side = exits[int(batch.streams.exit[0, batch.streams.number[0, other]])].side
    return [
        float(np.clip(gap / 0.5, -8.0, 8.0)),
        (its[3] - own[3]) / 0.5,
        flip * (its[1] - own[1]) / 0.3,
        flip * side,
        (np.ptp(batch.parcel(0, other).base.outline[:, 0]) / 2 - 0.175) / 0.05,
    ]


def row_of(batch: StreamBatch, place: int) -> Array:
    """What is to be shown of the parcel of a place, from what is sensed."""
    streams = batch.streams
    number = int(streams.number[0, place])
    exit = batch.config.exits.exits[int(streams.exit[0, number])]
    flip = -1.0 if exit.side < 0 else 1.0
    parcel = batch.parcel(0, place)
    x, y, theta, vx, vy, omega = batch.parcels.sensed[place]
    rear, _, right, left = box_of(parcel, (x, y, theta))
    length, width = np.ptp(parcel.base.outline, axis=0)
    y -= SHORT.line_y
    inner = right - SHORT.line_y if flip > 0.0 else SHORT.line_y - left
    start = FIRST_OF_ZONE if exit.side == 0 else max(FIRST_OF_ZONE, exit.first)
    others = {
        other: batch.parcels.sensed[other, 0] - x
        for other in np.nonzero(streams.present[0])[0].tolist()
        if other != place
    }
    ahead = min((o for o in others if others[o] > 0.0), key=lambda o: others[o], default=None)
    behind = max((o for o in others if others[o] < 0.0), key=lambda o: others[o], default=None)
    return np.array([
        flip * y / 0.3, flip * math.sin(theta), math.cos(theta), vx - 1.0, flip * vy / 0.5,
        flip * omega / 3.0, (length / 2 - 0.175) / 0.05, (inner - ROTORS) / 0.2,
        math.sin(2 * math.pi * (x - 0.05) / 0.1), math.cos(2 * math.pi * (x - 0.05) / 0.1),
        math.sin(2 * math.pi * flip * y / 0.1), math.cos(2 * math.pi * y / 0.1),
        (streams.clock[0] - streams.entered[0, number]) / 4.0, (rear - start) / 0.5, exit.side,
        1.0, (width / 2 - 0.175) / 0.05,
        20.0 if exit.side == 0 else float(np.clip((exit.last - x) / 0.5, -20.0, 20.0)),
        0.0,
        *neighbour(batch, place, ahead, True, flip),
        *neighbour(batch, place, behind, False, flip),
    ])  # fmt: skip


@pytest.mark.parametrize(
    "settings",
    [{}, {"sensors": Camera(), "actuators": Actuators(axis_speed=8.0)}],
    ids=["exact", "camera"],
)
def test_rows_say_what_is_sensed(settings: dict[str, Any]) -> None:
    env = bare(actions="parcels", stream=CROWD, duration=3.0, **settings)
    batch = env.batch
    rng = np.random.default_rng(0)
    seen = both = 0
    env.reset(seed=0)
    for _ in range(74):
        # Most roll on, so that several are on the line.
        drawn = rng.integers(0, 4, env.action_space.shape)
        observation, *_ = env.step(np.where(rng.random(drawn.shape) < 0.8, ROLL, drawn))
        streams = batch.streams
        assert observation.shape == (24, len(FEATURES))
        for place in range(24):
            if not streams.present[0, place]:
                assert not observation[place].any()
                continue
            np.testing.assert_allclose(observation[place], row_of(batch, place), atol=2e-5)
            seen += 1
            both += bool((observation[place, [AHEAD, BEHIND]] < 8.0).all())
    assert seen > 100
    assert both > 10


def test_the_first_are_those_of_sort() -> None:
    assert NAMES[:13] == [feature.name for feature in SORT_FEATURES[:13]]
    assert NAMES[12] == "time"
    assert [NAMES[AHEAD], NAMES[BEHIND]] == ["gap ahead", "gap behind"]


@pytest.mark.parametrize("name", ["parcels, exact", "parcels, camera, all varies"])
def test_a_queue_shows_who_is_behind_the_next_and_changes_nothing_else(name: str) -> None:
    stream = Stream(Poisson(15000.0), parcels=("S", "B"), speeds=(1.0, 2.0))
    kind = {**KINDS[name], "stream": stream, "gate": True, "max_parcels": 4}
    short, env = (bare(**kind, queue=queue) for queue in (1, 3))
    assert env.observation_space.shape == (7, len(FEATURES))
    assert env.action_space == short.action_space
    short.action_space.seed(0)
    counts = set()
    entry = np.delete(np.arange(AHEAD), 12)  # how it enters: all but the time and the neighbours
    for seed in (0, None):
        seen, same = env.reset(seed=seed), short.reset(seed=seed)
        streams = env.batch.streams
        known: dict[int, Array] = {}
        for _ in range(env.config.periods):
            assert_same((seen[0][:5], *seen[1:]), same)
            assert seen[0] in env.observation_space
            first = int(streams.coming[0])
            waiting = list(range(first, min(first + 3, int(streams.due[0]))))
            counts.add(len(waiting))
            table = seen[0][4:]
            assert not table[len(waiting) :].any()
            for number, row in zip(waiting, table, strict=False):
                assert row[COLUMN.present.place] == row[COLUMN.waits.place] == 1.0
                since = streams.clock[0] - streams.time[0, number]
                assert row[12] == pytest.approx(-since / 4.0, abs=1e-6)
                np.testing.assert_array_equal(row[entry], known.setdefault(number, row[entry]))
            action = short.action_space.sample()
            seen, same = env.step(action), short.step(action)
            # The surface's reward is that of the row of who enters next, once.
            assert env.batch.parcels.reward[4:].tolist() == [seen[4]["reward_waiting"], 0.0, 0.0]
    assert counts >= {1, 2, 3}
    assert len(known) > 3
