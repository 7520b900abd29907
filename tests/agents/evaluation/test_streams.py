"""The comparison on streams: rates that are sustained, results that are kept, and their tables."""

import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.base import find_axes
from surface_gym.agents.evaluation import capacity, streams
from surface_gym.agents.evaluation.benchmark import half_interval
from surface_gym.agents.evaluation.capacity import Case, Measurement
from surface_gym.agents.evaluation.streams import ARRANGED, COLUMNS, EVENT, MODULES, StreamResult
from surface_gym.agents.scheduling.maneuvers import ColumnGroups
from tests.agents.evaluation.made import SHARES, at, stream_results, stream_rows
from tests.agents.rules.runs import Scripted

BY_NAME = {method.name: method for method in streams.stream_methods()}


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capacity, "REPLICATIONS", 4)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """One stream, two replications."""
    monkeypatch.setattr(capacity, "REPLICATIONS", 2)
    monkeypatch.setattr(streams, "cases", lambda preset, exits: [Case("S", 2.0, preset, exits)])


def test_no_more_come_than_the_entrance_takes() -> None:
    assert Case("S", 1.5).ceiling == pytest.approx(3600.0 * 1.5 / 0.27)
    assert Case("S and B", 1.0, exits="chutes").ceiling == pytest.approx(3600.0 / 0.37)


RUNGS = [
    ARRANGED, streams.FOLLOWED, streams.SERIES, streams.TRIPLES, COLUMNS, streams.SIX_COLUMNS,
    MODULES, streams.SIX_MODULES,
]  # fmt: skip


def test_every_method_acts_in_its_own_environment() -> None:
    assert list(BY_NAME)[:10] == [*RUNGS, EVENT, streams.EACH]
    for name, method in BY_NAME.items():
        for case in (Case("S and B", 1.0, preset) for preset in method.presets):
            config = method.config(case, 2000.0)
            assert (config.actions, config.stream_task.gate) == (method.actions, method.gate)
            assert config.exits.names == ("left", "right", "straight")
            assert config.randomisation.friction == (0.2 if case.preset == "camera" else 0.0)
            assert len(config.chosen_orientations) == (6 if "six" in name else 4)
    config = BY_NAME[EVENT].config(Case("S", 1.5, exits="chutes"), 2000.0)
    assert len(config.exits.names) == 5


def test_a_method_that_cannot_sort_has_no_capacity(monkeypatch) -> None:
    monkeypatch.setattr(streams, "make_scheduler", lambda *_: None)
    result = streams.compute_stream(BY_NAME[MODULES], Case("S", 1.5))
    assert (result.actuators, result.capacity, result.best) == (0, None, None)


def test_every_result_is_computed_once() -> None:
    methods = streams.stream_methods()
    jobs = streams.stream_jobs(methods, ("sides", "chutes"))
    assert pickle.loads(pickle.dumps(jobs)).keys() == jobs.keys()  # sent to other processes
    assert len(jobs) == 2 * 6 * sum(len(method.presets) for method in methods)
    assert {key[3:] for key in jobs} == {
        (case.mix, case.speed, exits)
        for exits in ("sides", "chutes")
        for case in streams.cases(exits=exits)
    }


@pytest.mark.usefixtures("small")
class TestComputing:
    def test_zones_are_as_long_as_lets_most_parcels_in(self, monkeypatch) -> None:
        known = {4: 3000.0, 5: 3500.0, 6: 3400.0, 7: 3300.0}
        tried = []

        def library(_: object, groups: Any, **__: float) -> Any:
            tried.append(groups.columns)
            right = np.array([groups.columns in known])
            return SimpleNamespace(right=right, gaps=np.zeros(1), signature=right, groups=groups)

        monkeypatch.setattr(streams, "make_library", library)
        monkeypatch.setattr(streams, "predict_rate", lambda made, *_: known[made.groups.columns])
        # The best does not do without touches.
        monkeypatch.setattr(
            streams, "make_scheduler", lambda _, groups: groups if groups.columns != 5 else None
        )
        method = BY_NAME[ARRANGED]
        found: Any = method.make(method.config(Case("S", 2.0), 3000.0))
        assert found == ColumnGroups(6, 1, exclusive=True)
        assert tried == [4, 5, 6, 7]

    def test_a_rung_is_measured_with_its_hardware(self) -> None:
        result = streams.compute_stream(BY_NAME[ARRANGED], Case("S", 2.0))
        assert (result.actuators, result.modules) == (1, 4 * result.columns)
        assert result.capacity.offered == Case("S", 2.0).ceiling  # all that the entrance takes
        assert 0.9 < result.capacity.rate / result.best < 1.1
        assert 0.3 < result.turns < 2.0  # the same exit may come twice

    def test_finished_results_are_kept(self, tmp_path, monkeypatch) -> None:
        monkeypatch.setattr(capacity, "find_capacity", lambda *_: at(3000.0))
        each = [replace(BY_NAME[EVENT], name=name) for name in ("one", "other")]
        first = streams.compute_streams(each[:1], 1, tmp_path)
        with (tmp_path / streams.FILE).open("a") as file:
            file.write('{"method": "zone')  # a line broken off
        seen: list[tuple[int, int]] = []
        both = streams.compute_streams(each, 1, tmp_path, lambda *given: seen.append(given[:2]))
        assert (both[:2], seen) == (first, [(3, 4), (4, 4)])
        assert [(row.method, row.preset) for row in both[2:]] == [
            ("other", "exact"), ("other", "camera"),
        ]  # fmt: skip
        monkeypatch.setattr(capacity, "find_capacity", None)  # nothing is left to compute
        assert streams.compute_streams(each, 1, tmp_path) == both


def with_rates(*rates: list[int]) -> streams.StreamResults:
    """Of methods "0", "1" and so on, offered the same, by deliveries in each replication."""
    found = [
        Measurement(3000.0, right, right, [0.0] * 3, [0.0] * 3, 0, 36.0, 8.0) for right in rates
    ]
    return streams.StreamResults(
        tuple(
            StreamResult(str(k), "exact", "S", 1.0, "sides", 55, 1, 4, each, None)
            for k, each in enumerate(found)
        )
    )


class TestTables:
    """Of results made by hand."""

    CASE = Case("S", 1.0)

    def test_replications_are_compared_in_pairs(self) -> None:
        """The same parcels make both fast or slow: so a small difference shows."""
        results = with_rates([10, 20, 30], [11, 21, 32])
        mean, margin = results.difference("1", "0", self.CASE)
        assert (mean, margin) == (pytest.approx(400.0 / 3.0), pytest.approx(143.4, abs=0.1))
        assert results.leader(self.CASE) is None
        assert with_rates([10, 20, 30], [12, 22, 32]).leader(self.CASE) == "1"
        # Offered something else, they are not.
        one, two = with_rates([10, 20, 30], [12, 22, 32]).rows
        apart = replace(two, capacity=replace(two.capacity, offered=2000.0))
        results = streams.StreamResults((one, apart))
        assert results.difference("1", "0", self.CASE) == (200.0, pytest.approx(3513.0, abs=1.0))
        assert results.difference("1", "nobody", self.CASE) is None
        assert math.isnan(results.rate("nobody", self.CASE))

    def test_the_ladder(self) -> None:
        table = streams.ladder_table(stream_results(), "exact")
        rows = {row[0]: row[1:] for row in table.rows}
        best = streams.BEST.format(MODULES)
        assert list(rows) == [*SHARES, best, streams.ENTRANCE]
        assert rows[ARRANGED] == ("-", *["cannot"] * 6, "-", "-")
        assert rows[streams.SERIES][:2] == ("8", "0")
        # 180 parcels/h either way, ten times: 2.262 * 189.7 / sqrt(10)
        assert (rows[COLUMNS][0], rows[COLUMNS][5]) == ("55", "5760 ±136")
        assert rows[COLUMNS][-1] == "2.0"  # 8 of modules, 4 of which turn together
        # As good as another: nothing is bold.
        assert rows[MODULES][1:7] == rows[EVENT][1:7]
        assert rows[best][5] == "9632"
        assert rows[streams.ENTRANCE][1:7] == ("13333", "20000", "26667", "9730", "14595", "19459")
        assert "cannot; zones in series: 7, 7, 7, 7, 7, 7." in table.caption
        without = [row for row in stream_rows() if row.method != EVENT]
        table = streams.ladder_table(streams.StreamResults(tuple(without)), "camera")
        assert dict(zip(table.header, table.rows[3], strict=True))["S, 1 m/s"] == "**7920 ±136**"

    def test_steps_of_the_ladder(self) -> None:
        table = streams.step_table(stream_results(), "exact")
        rows = {row[0]: row[1:] for row in table.rows}
        assert list(rows) == [f"{MODULES} over {COLUMNS}"]
        assert rows[f"{MODULES} over {COLUMNS}"][0] == "+2520 ±192 (+46.7 %)"

    def test_every_number_has_a_row(self) -> None:
        rows = streams.stream_numbers(stream_results())
        assert {row["metric"] for row in rows} > {"capacity", "best known", "turns per parcel"}
        key = ("controller", "preset", "exits", "parcels", "speed", "metric")
        wanted = (COLUMNS, "exact", "sides", "S", 1.0, "capacity")
        found = [row["value"] for row in rows if tuple(row[name] for name in key) == wanted]
        assert found == [pytest.approx(0.4 * self.CASE.ceiling, rel=0.05)]


SMALL = capacity.Case("S", 1.5)


def offer(method: Any, rate: float, whole: bool = True) -> Measurement | None:
    controller = method.make(method.config(SMALL, rate))
    return capacity.measure(method, controller, SMALL, rate, whole)


def delivery(
    offered: float, right: int = 1000, delivered: int = 1000, jams: int = 0
) -> Measurement:
    return Measurement(offered, [right], [delivered], [0.0], [0.0], jams, 20.0, 8.0)


def test_figures_are_those_of_all_replications() -> None:
    found = Measurement(3000.0, [10, 12], [10, 15], [1.0, 0.0], [0.2, 0.4], 0, 20.0, 8.0)
    assert (found.rates.tolist(), found.rate) == ([1800.0, 2160.0], pytest.approx(1980.0))
    assert found.share_right == pytest.approx(22 / 25)
    assert (found.touches_per_1000, found.waited) == (pytest.approx(40.0), pytest.approx(0.3))
    # Two values: half the interval is 12.706 of the mean's standard error.
    assert found.margin == pytest.approx(12.706 * 180.0, rel=1e-4)
    samples = np.random.default_rng(0).normal(size=(2000, 30))
    within = [abs(values.mean()) <= half_interval(values) for values in samples]
    assert np.mean(within) == pytest.approx(0.95, abs=0.015)


@pytest.mark.parametrize(
    ("preset", "right", "jams", "expected"),
    [
        ("exact", 999, 0, True), ("exact", 998, 0, False), ("exact", 1000, 1, False),
        ("camera", 995, 0, True), ("camera", 994, 0, False), ("exact", 0, 0, False),
    ],
)  # fmt: skip
def test_what_is_sustained(preset, right, jams, expected) -> None:
    found = delivery(3000.0, right, delivered=1000 if right else 0, jams=jams)
    assert found.is_sustained(replace(SMALL, preset=preset)) is expected


@pytest.mark.parametrize("rate", [500.0, 1234.0, 3600.0, 20000.0])
def test_what_counts_are_whole_gaps_after_the_warm_up(rate) -> None:
    counted = capacity.counted_time(30.0, rate)
    gaps = counted * rate / 3600.0
    assert gaps == pytest.approx(round(gaps))
    assert 22.0 - 3600.0 / rate < counted <= 22.0 + 1e-9
    # One at least.
    assert capacity.counted_time(30.0, 150.0) == pytest.approx(24.0)
    assert capacity.counted_time(30.0, 10.0) == 30.0


@pytest.mark.parametrize("name", [EVENT, ARRANGED])
def test_what_comes_leaves_in_the_long_run(name) -> None:
    """To the parcel, as whole gaps count: every replication delivers what was offered."""
    found = offer(BY_NAME[name], 3000.0)
    assert found == offer(BY_NAME[name], 3000.0)
    assert (found.share_right, found.rates) == (1.0, pytest.approx(3000.0, rel=0.12))
    assert (found.rate, found.jams) == (pytest.approx(3000.0, rel=0.03), 0)


def test_every_method_meets_the_same_stream() -> None:
    """A third of it is to go straight on: so many are right with all axes at 90 deg."""
    config = BY_NAME[EVENT].config(SMALL, 3000.0)
    roll = [find_axes(config).roll] * config.action_kind.size
    straight = replace(BY_NAME[EVENT], make=lambda _: Scripted([[roll]] * 4))
    held, rule = offer(straight, 3000.0), offer(BY_NAME[EVENT], 3000.0)
    assert held.delivered == pytest.approx(rule.delivered, abs=3)
    assert 0.15 < held.share_right < 0.55
    # A lost rate is broken off.
    assert offer(straight, 3000.0, whole=False) is None


def test_a_jam_is_told() -> None:
    """Of a machine that always gets one action: every axis at 0 deg."""
    brake = capacity.StreamMethod(
        "brake", "modules", False, lambda config: Scripted([[[0] * config.action_kind.size]] * 4)
    )
    whole = offer(brake, 9000.0)
    assert (whole.jams, whole.rate, whole.waiting) == (4, 0.0, pytest.approx([0.0] * 4))
    assert not whole.is_sustained(SMALL)


def search(
    monkeypatch: pytest.MonkeyPatch, name: str, known: Callable[[float], Measurement]
) -> tuple[Measurement | None, list[float]]:
    """The greatest rate, and all that were tried, where a measurement is known by its rate."""
    tried: list[float] = []

    def measure(*given: Any) -> Measurement:
        tried.append(given[3])
        return known(given[3])

    monkeypatch.setattr(capacity, "measure", lambda *given, **_: measure(*given))
    return capacity.find_capacity(BY_NAME[name], None, SMALL), tried


@pytest.mark.parametrize("carried", [5000.0, 9000.0, 17000.0])
def test_without_a_gate_more_may_be_delivered_where_fewer_come(monkeypatch, carried) -> None:
    """Beyond what is carried parcels hinder each other: less is delivered the more come."""

    def known(rate: float) -> Measurement:
        delivered = rate if rate <= carried else carried - 0.1 * (rate - carried)
        right = round(delivered * 1000.0)
        return Measurement(rate, [right], [right], [0.0], [0.0], 0, 3600.0 * 1000.0, 8.0)

    found, _ = search(monkeypatch, EVENT, known)
    assert carried / 1.03 <= found.rate <= carried


@pytest.mark.parametrize("share", [math.inf, 0.99, 0.7, 0.3, 0.07, 0.9 * capacity.LEAST])
def test_the_greatest_rate_is_found_to_two_in_a_hundred(monkeypatch, share) -> None:
    """What the entrance takes comes first; below the least rate there is no capacity."""
    most = share * SMALL.ceiling
    found, tried = search(
        monkeypatch, MODULES, lambda rate: delivery(rate, right=1000 if rate <= most else 500)
    )
    if share < capacity.LEAST:
        assert found is None
        assert min(tried) == pytest.approx(capacity.LEAST * SMALL.ceiling)
    elif math.isinf(share):
        assert tried == [found.offered] == [SMALL.ceiling]
    else:
        assert most / 1.02 <= found.offered <= most
        assert len(tried) <= 12
