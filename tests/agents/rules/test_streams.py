"""Rules that decide parcel by parcel, the layout of a stream, and zones that turn as a whole."""

import math
from functools import partial

import numpy as np
import pytest

from surface_gym.agents import library
from surface_gym.agents.rules import streams, zones
from surface_gym.agents.rules.reservation import Reservation, list_asked
from surface_gym.agents.rules.streams import PAST_START, SIDE, StreamEventRule, StreamFixedLayout
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import FEATURES, OWN, PRESENT, WAITS
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Camera
from tests.agents.rules.runs import counts, gated, line, zoned
from tests.flow.flows import trace

LEFT, RIGHT, ROLL = 2, 1, 3  # of the default orientations: -45, 45 and 90 deg


def table(rows: int, *parcels: tuple[float, float]) -> np.ndarray:
    """Show parcels, by how far each is past its start and the side of its exit."""
    seen = np.zeros((rows, len(FEATURES)), dtype=np.float32)
    for row, (past, side) in zip(seen, parcels, strict=False):
        row[[PRESENT, streams.PAST_START, streams.SIDE]] = 1.0, past, side
    return seen


def test_a_gate_is_opened_at_once_and_a_parcel_that_waits_there_has_no_halves() -> None:
    config = gated(max_parcels=2)
    seen = table(3, (0.1, 1.0))
    seen[-1, [PRESENT, WAITS, streams.PAST_START, streams.SIDE]] = 1.0, 1.0, 5.0, 1.0
    action, _ = StreamEventRule(config).predict(seen)
    assert action.tolist() == [LEFT, LEFT, ROLL, ROLL, streams.OPEN]
    assert config.action_space().contains(action)


@pytest.mark.parametrize(("make", "touches"), [(StreamEventRule, 0), (streams.SortEach, None)])
def test_a_thin_stream_is_sorted(make, touches) -> None:
    config = line(line().stream_task.stream.with_rate(900.0))
    found = counts(make(config), config)
    assert found["right"] >= 4
    assert found["wrong"] == 0
    assert touches in (None, found["touches"])


def test_for_each_parcel_the_agent_of_sort_decides_by_its_row() -> None:
    config = line(trace((0.0, "right"), (0.4, "left"), (0.8, "straight")), max_parcels=4)
    each, agent = streams.SortEach(config), library.load("sort-ppo", 0)
    batch = StreamBatch(config, 1)
    batch.seed(0, np.random.default_rng(0))
    batch.reset(np.array([0]))
    met = set()
    for _ in range(30):
        seen = batch.observation[0]
        action, _ = each.predict(seen)
        for row, halves in zip(seen, action.reshape(4, 2), strict=True):
            if row[PRESENT] == 0.0 or row[streams.SIDE] == 0.0:
                assert halves.tolist() == [ROLL, ROLL]
            else:
                assert halves.tolist() == list(divmod(int(agent.predict(row[:OWN])[0]), 4))
                met.add(row[streams.SIDE])
        batch.step(config.action_kind.commands(action[np.newaxis], 1))
    assert met == {1.0, -1.0}


def test_a_fixed_layout_sorts_to_the_left_alone() -> None:
    for name, right, wrong in (("left", 1, 0), ("right", 0, 1), ("straight", 0, 1)):
        config = line(trace((0.0, name)), actions="modules", duration=4.0)
        assert counts(StreamFixedLayout(config), config, num_envs=1) == {
            "right": right, "wrong": wrong, "touches": 0,
        }  # fmt: skip
    actions, _ = StreamFixedLayout(config).predict(table(3)[np.newaxis].repeat(2, axis=0))
    assert actions.shape == (2, config.action_kind.size)
    assert (actions == LEFT).all()
    assert StreamFixedLayout(config).predict(table(3))[0].tolist() == actions[0].tolist()


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (StreamEventRule, {"actions": "modules"}, "actions must be one of 'parcels', got"),
        (StreamEventRule, {"orientations": "any"}, "orientations must be some on offer, got 'any'"),
        (StreamEventRule, {"orientations": (0.0, math.pi / 2)}, "must hold 45 deg|-45 deg"),
        (StreamFixedLayout, {}, "actions must be one of 'modules', got 'parcels'"),
        (StreamFixedLayout, {"actions": "modules", "gate": True}, "gate must be False for a layo"),
        (StreamFixedLayout, {"actions": "modules", "orientations": (0.0, 1.0)}, "must hold"),
        (partial(streams.SortEach, name="nobody"), {}, "name must be one of"),
    ],
)
def test_what_they_cannot_act_in_is_refused(make, arguments, message) -> None:
    with pytest.raises(ValueError, match=message):
        make(line(**arguments))


def test_each_rolls_until_it_is_past_its_exits_start() -> None:
    """Many environments are decided as each alone."""
    seen = table(5, (-0.1, 1.0), (0.1, 1.0), (0.1, -1.0), (0.1, 0.0))
    rule = StreamEventRule(line(max_parcels=5))
    action, state = rule.predict(seen)
    assert action.reshape(5, 2).tolist() == [
        [ROLL, ROLL], [LEFT, LEFT], [RIGHT, RIGHT], [ROLL, ROLL], [ROLL, ROLL],
    ]  # fmt: skip
    assert state is None
    tables = np.stack([seen, table(5, (0.1, -1.0), (0.1, 1.0)), table(5)])
    assert rule.predict(tables)[0].tolist() == [rule.predict(each)[0].tolist() for each in tables]


SMALL = Stream(Steady(9000.0), parcels=("S",), speeds=1.0)
COLUMNS = 5
SIZE = 1.0  # of an S-box's half of 0.125 m in its row: (0.125 - 0.175) / 0.05, but for the sign


def zone_table(
    config: EnvConfig, *parcels: tuple[float, float], waits: float | None = None
) -> np.ndarray:
    """S-boxes, by where the rear is past the zone's start [m] and the side of the exit; and the
    side of the one at the gate, if there is one; behind it are longer ones to the other side.
    """
    seen = table(config.stream_task.rows, *((rear / 0.5, side) for rear, side in parcels))
    seen[: len(parcels), 6] = -SIZE
    if waits is not None:
        head, columns = config.stream_task.max_parcels, [PRESENT, WAITS, PAST_START, SIDE, 6]
        seen[head, columns] = 1.0, 1.0, -1.0, waits, -SIZE
        seen[head + 1 :, columns] = 1.0, 1.0, -1.0, -waits, SIZE
    return seen


def arranged(action: np.ndarray, config: EnvConfig) -> list[list[int]]:
    """The choices of the zone's columns, each once, and of the others."""
    _, rows, _, columns = config.site.zone
    grid = action[:-1].reshape(rows, columns)
    return [sorted(set(part.ravel().tolist())) for part in (grid[:, :COLUMNS], grid[:, COLUMNS:])]


@pytest.mark.parametrize(
    ("parcels", "choice"),
    [
        ([], ROLL),
        ([(-0.01, 1.0)], ROLL),  # not yet wholly in it
        ([(0.01, 1.0)], LEFT),
        ([(0.01, -1.0)], RIGHT),
        ([(0.01, 0.0)], ROLL),
        ([(0.51, 1.0)], ROLL),  # out of it
        ([(0.51, 1.0), (0.2, -1.0)], RIGHT),
    ],
)
def test_a_zone_that_turns_leads_the_parcel_that_is_wholly_in_it(parcels, choice) -> None:
    config = zoned(SMALL)
    action, _ = zones.WholeZone(config, COLUMNS, alone=True).predict(zone_table(config, *parcels))
    assert arranged(action, config) == [[choice], [ROLL]]


def test_a_zone_is_arranged_while_it_is_free_and_stays_until_the_parcel_is_out() -> None:
    """Each environment remembers its own until an episode begins."""
    config, state = zoned(SMALL, queue=3), None
    zone = zones.ArrangedZone(config, COLUMNS, alone=True)
    for parcels, waits, choice in (
        ([], None, ROLL),
        ([], 1.0, LEFT),  # for the one at the gate
        ([(-0.4, 1.0)], -1.0, LEFT),  # which is nearer than the next
        ([(-0.2, 1.0), (-0.5, -1.0)], 0.0, LEFT),  # it has come into the zone
        ([(0.49, 1.0), (-0.3, -1.0)], 0.0, LEFT),
        ([(0.51, 1.0), (-0.3, -1.0)], 0.0, RIGHT),  # out: the next one's
        ([(0.9, 1.0)], None, RIGHT),  # no other comes: as it was
    ):
        action, state = zone.predict(zone_table(config, *parcels, waits=waits), state)
        assert arranged(action, config) == [[choice], [ROLL]]
    _, state = zone.predict(
        np.stack([zone_table(config, (-0.4, side)) for side in (1.0, -1.0, 1.0)])
    )
    inside = np.stack([zone_table(config, (0.1, -1.0))] * 3)
    actions, _ = zone.predict(inside, state, np.array([False, False, True]))
    assert [arranged(each, config)[0] for each in actions] == [[LEFT], [RIGHT], [ROLL]]


@pytest.mark.parametrize("kind", [zones.WholeZone, zones.ArrangedZone])
class TestBoth:
    def test_a_crowd_is_sorted_one_at_a_time(self, kind) -> None:
        config = zoned(SMALL)
        columns = zones.find_best_zone(kind, config)
        assert columns is not None
        found = counts(kind(config, columns), config)
        assert (found["wrong"], found["touches"]) == (0, 0)
        each = gated(SMALL)
        many = counts(Reservation(each), each)["right"]
        assert 4 < found["right"] < many  # a rule that turns modules for each parcel lets in more

    def test_one_column_less_than_the_shortest_does_not_sort(self, kind) -> None:
        config = zoned(SMALL)

        def sorts(columns: int) -> bool:
            found = zones.measure_crossings(
                lambda s: kind(s, columns, alone=True), config, list_asked(config),
                zones.zone_span(config, columns),
            )  # fmt: skip
            return bool(found.right.all())

        best = zones.find_best_zone(kind, config)
        assert best is not None
        shortest = next(columns for columns in range(1, 22) if sorts(columns))
        assert shortest <= best <= shortest + 2
        with pytest.raises(ValueError, match="columns must be enough for every parcel"):
            kind(config, shortest - 1)

    def test_what_a_camera_shows_is_sorted_too(self, kind) -> None:
        config = zoned(SMALL, sensors=Camera(), randomisation=Randomisation(friction=0.2))
        columns = zones.find_best_zone(kind, config)
        assert columns is not None
        found = counts(kind(config, columns), config)
        assert found["right"] > 4
        assert found["wrong"] == 0

    @pytest.mark.parametrize(
        ("config", "columns", "named"),
        [
            (gated(), 5, "actions must be one of 'modules', got 'parcels'"),
            (line(actions="modules"), 5, "gate must be True for a zone .*, got False"),
            (zoned(), 0, "columns must be between 1 and 21, got 0"),
            (zoned(), 22, "columns must be between 1 and 21, got 22"),
            (zoned(exits="chutes"), 5, "exits must start at 0.5 m, where the zone does"),
        ],
    )
    def test_what_it_cannot_act_in_is_refused(self, kind, config, columns, named) -> None:
        with pytest.raises(ValueError, match=named):
            kind(config, columns)


def test_no_zone_sorts_parcels_that_come_to_rest_in_it() -> None:
    slow = zoned(Stream(Steady(1000.0), speeds=0.2), duration=20.0)
    assert zones.find_best_zone(zones.ArrangedZone, slow) is None


def test_passing_is_that_of_the_motion() -> None:
    """Straight on at 1 m/s on a slope that makes up for rolling: geometry says when."""
    config = zoned(Stream(Steady(1000.0), destinations={"straight": 1.0}, speeds=1.0))
    span = 0.8, 1.2
    found = zones.measure_crossings(
        lambda s: zones.WholeZone(s, 5, alone=True), config, list_asked(config), span
    )
    entry = config.entry_x
    assert found.right.tolist() == [True]
    assert found.enters[0] == pytest.approx(span[0] - entry - 0.25, abs=0.02)
    assert found.leaves[0] == pytest.approx(span[1] - entry, abs=0.02)
    assert found.gaps(0.04)[0, 0] == pytest.approx(0.4 + 0.25 + 0.04, abs=0.03)
    assert config.timing.steps <= zones.TRIES
