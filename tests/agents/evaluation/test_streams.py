"""The comparison on streams: rates that are sustained, results that are kept, and their tables."""

import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.evaluation import capacity, streams
from surface_gym.agents.evaluation.benchmark import half_interval
from surface_gym.agents.evaluation.capacity import Case, Measurement
from surface_gym.agents.evaluation.methods import FIXED
from surface_gym.agents.evaluation.streams import ARRANGED, CURVE, EVENT, RESERVATION, SEARCHED
from tests.agents.evaluation.made import RULES, SHARES, stream_results, stream_rows
from tests.agents.rules.runs import Scripted

BY_NAME = {method.name: method for method in streams.stream_methods()}


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capacity, "REPLICATIONS", 4)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """One stream, one load, two replications."""
    monkeypatch.setattr(capacity, "REPLICATIONS", 2)
    monkeypatch.setattr(streams, "cases", lambda preset: [Case("S", 2.0, preset)])
    monkeypatch.setattr(streams, "LOADS", (0.25,))


def test_the_ceiling_is_parcels_end_to_end() -> None:
    assert Case("S", 1.5).ceiling == pytest.approx(3600.0 * 1.5 / 0.3)
    assert Case("S and B", 1.0).ceiling == pytest.approx(3600.0 / 0.4)
    assert (streams.LOADS[0], streams.LOADS[-1], len(streams.LOADS)) == (0.1, 1.0, 8)


NAMES = [FIXED, ARRANGED, streams.TURNED, streams.EVENT, streams.EACH, RESERVATION]


@pytest.mark.parametrize("method", streams.stream_methods(), ids=lambda method: method.name)
def test_every_method_acts_in_its_own_environment(method) -> None:
    assert list(BY_NAME)[:6] == NAMES
    for preset in method.presets:
        config = method.config(Case("S and B", 1.0, preset), 2000.0)
        assert (config.actions, config.stream_task.gate) == (method.actions, method.gate)
        assert config.exits.names == ("left", "right", "straight")
        assert config.randomisation.friction == (0.2 if preset == "camera" else 0.0)
    config = method.config(Case("S", 1.5), 2000.0)
    action, _ = method.make(config).predict(0.0 * config.observation_space().low)
    assert config.action_space().contains(action)


def test_a_method_that_cannot_sort_has_no_capacity(monkeypatch) -> None:
    monkeypatch.setattr("surface_gym.agents.evaluation.streams.find_best_zone", lambda *_: None)
    result = streams.compute_stream(BY_NAME[ARRANGED], Case("S", 1.5), SEARCHED)
    assert (result.can, result.capacity, result.eased) == (False, None, None)


def test_every_result_is_computed_once() -> None:
    jobs = streams.stream_jobs(streams.stream_methods())
    assert pickle.loads(pickle.dumps(jobs)).keys() == jobs.keys()  # sent to other processes
    searched = [key for key in jobs if key[-1] == SEARCHED]
    count = sum(len(method.presets) for method in streams.stream_methods())
    assert len(searched) == 6 * count
    assert len(jobs) - len(searched) == len(streams.LOADS) * len(streams.stream_methods())
    assert {key[3:5] for key in jobs if key[-1] != SEARCHED} == {(CURVE.mix, CURVE.speed)}
    assert {key[3:5] for key in searched} == {(case.mix, case.speed) for case in streams.cases()}


@pytest.mark.usefixtures("small")
class TestComputing:
    def test_at_80_percent_of_the_capacity(self) -> None:
        """Without a capacity the least rate is measured."""
        case = Case("S", 2.0)
        result = streams.compute_stream(BY_NAME[RESERVATION], case, SEARCHED)
        assert result.eased.offered == pytest.approx(0.8 * result.capacity.rate)
        assert result.eased.share_right == 1.0
        result = streams.compute_stream(BY_NAME[FIXED], case, SEARCHED)
        assert (result.can, result.capacity) == (True, None)
        assert result.eased.offered == pytest.approx(case.ceiling / 16.0)

    def test_finished_results_are_kept(self, tmp_path, monkeypatch) -> None:
        some = [BY_NAME[FIXED], BY_NAME[streams.TURNED]]
        first = streams.compute_streams(some[:1], 1, tmp_path)
        with (tmp_path / streams.FILE).open("a") as file:
            file.write('{"method": "zone')  # a line broken off
        seen: list[tuple[int, int]] = []
        both = streams.compute_streams(some, 1, tmp_path, lambda *given: seen.append(given[:2]))
        assert (both[:2], seen) == (first, [(done, 5) for done in (3, 4, 5)])
        loads = [(result.method, result.preset, result.load) for result in both[2:]]
        expected = (("exact", SEARCHED), ("exact", 0.25), ("camera", SEARCHED))
        assert loads == [(streams.TURNED, *each) for each in expected]
        monkeypatch.setattr(capacity, "measure", None)  # nothing is left to compute
        assert streams.compute_streams(some, 1, tmp_path) == both


class TestTables:
    """Of results made by hand."""

    def test_rates_and_ratios(self) -> None:
        results = stream_results()
        assert results.names == tuple(SHARES)
        assert results.rate(RESERVATION, CURVE) == pytest.approx(0.6 * CURVE.ceiling, rel=0.02)
        assert results.ratio(RESERVATION, streams.EVENT, CURVE) == pytest.approx(1.5, rel=0.02)
        assert results.ratio(RESERVATION, streams.BOUND, CURVE) == pytest.approx(0.75, rel=0.02)
        assert results.ratio(streams.BOUND, streams.CEILING, CURVE) == pytest.approx(0.8)
        assert results.ratio(streams.EVENT, ARRANGED, CURVE) == math.inf
        assert math.isnan(results.ratio(FIXED, ARRANGED, CURVE))
        assert math.isnan(results.rate("nobody", CURVE))

    def test_the_first_table(self) -> None:
        table = streams.headline(stream_results())
        rows = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
        assert list(rows) == [*SHARES, streams.BOUND, streams.CEILING]
        assert rows[FIXED]["parcels/h"] == "0"
        assert (rows[ARRANGED]["parcels/h"], rows[ARRANGED]["95 %"]) == ("cannot", "-")
        # 180 parcels/h either way, ten times: 2.262 * 189.7 / sqrt(10)
        expected = {
            "parcels/h": "8100", "95 %": "±136", "touches/1000": "22", "/turned": "3.00",
            "/arranged": "-",
        }  # fmt: skip
        assert {name: rows[RESERVATION][name] for name in expected} == expected
        assert rows[streams.CEILING]["parcels/h"] == "13500"

    def test_every_stream_has_a_column(self) -> None:
        results = stream_results()
        table = streams.capacity_table(results, "camera")
        assert table.header[1:] == tuple(case.label for case in streams.cases())
        names = [ARRANGED, streams.TURNED, streams.EVENT, RESERVATION]
        assert [row[0] for row in table.rows] == [*names, streams.BOUND, streams.CEILING]
        assert set(table.rows[0][1:]) == {"cannot"}
        assert table.rows[1][1].startswith(("2340 ±", "2400 ±"))
        ratios = streams.ratio_table(results, streams.EVENT)
        assert [row[0] for row in ratios.rows] == [ARRANGED, streams.TURNED, RESERVATION]
        eased = streams.eased_table(results, "exact")
        assert eased.rows[1][1] == "cannot"
        assert 0.25 < float(eased.rows[0][1].split(",")[0]) < 0.4  # a third
        assert eased.rows[3][1] == "1.0000, 0.0, 0.25"

    def test_every_number_has_a_row(self) -> None:
        rows = streams.stream_numbers(stream_results())
        assert {row["metric"] for row in rows} > {"capacity", "share_right", "waiting", "bound"}
        key = ("controller", "preset", "parcels", "speed", "metric")
        wanted = (EVENT, "exact", "S", 1.0, "capacity")
        found = [row["value"] for row in rows if tuple(row[name] for name in key) == wanted]
        assert found == [pytest.approx(0.4 * Case("S", 1.0).ceiling, rel=0.05)]


@pytest.mark.parametrize("case", [Case("S", 1.5), Case("S and B", 1.5)], ids=lambda case: case.mix)
def test_the_bound_lies_below_the_ceiling(case) -> None:
    bound = streams.packing_bound(BY_NAME[streams.EVENT], case)
    assert 0.5 * case.ceiling < bound < case.ceiling


def test_every_stream_has_a_bound(monkeypatch) -> None:
    seen = []

    def known(_: object, case: Case) -> float:
        seen.append(case)
        return 100.0

    monkeypatch.setattr(streams, "packing_bound", known)
    results = streams.StreamResults.of(RULES, stream_rows())
    assert (seen, results.rate(streams.BOUND, CURVE)) == (streams.cases(), 100.0)


SMALL = capacity.Case("S", 1.5)


def offer(method: Any, rate: float, whole: bool = True) -> Measurement | None:
    controller = method.make(method.config(SMALL, rate))
    return capacity.measure(method, controller, SMALL, rate, whole)


def delivery(
    offered: float, right: int = 1000, delivered: int = 1000, jams: int = 0
) -> Measurement:
    return Measurement(offered, [right], [delivered], [0.0], [0.0], jams, 20.0)


def test_figures_are_those_of_all_replications() -> None:
    found = Measurement(3000.0, [10, 12], [10, 15], [1.0, 0.0], [0.2, 0.4], 0, 20.0)
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


@pytest.mark.parametrize("name", [EVENT, RESERVATION])
def test_what_comes_leaves_in_the_long_run(name) -> None:
    """To the parcel, as whole gaps count: every replication delivers what was offered."""
    found = offer(BY_NAME[name], 3000.0)
    assert found == offer(BY_NAME[name], 3000.0)
    assert (found.share_right, found.rates) == (1.0, pytest.approx(3000.0, rel=0.12))
    assert (found.rate, found.jams) == (pytest.approx(3000.0, rel=0.03), 0)


def test_every_method_meets_the_same_stream() -> None:
    """A third of it is to go left: so many the layout has right, and the rule by all exits."""
    layout, rule = offer(BY_NAME[FIXED], 3000.0), offer(BY_NAME[EVENT], 3000.0)
    assert layout.delivered == pytest.approx(rule.delivered, abs=2)
    assert 0.15 < layout.share_right < 0.55
    # A lost rate is broken off.
    assert offer(BY_NAME[FIXED], 3000.0, whole=False) is None


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
        return Measurement(rate, [right], [right], [0.0], [0.0], 0, 3600.0 * 1000.0)

    found, _ = search(monkeypatch, EVENT, known)
    assert carried / 1.03 <= found.rate <= carried


@pytest.mark.parametrize("share", [math.inf, 0.99, 0.7, 0.3, 0.07, 0.9 * capacity.LEAST])
def test_the_greatest_rate_is_found_to_two_in_a_hundred(monkeypatch, share) -> None:
    """The ceiling comes first; below the least rate there is no capacity."""
    most = share * SMALL.ceiling
    found, tried = search(
        monkeypatch, RESERVATION, lambda rate: delivery(rate, right=1000 if rate <= most else 500)
    )
    if share < capacity.LEAST:
        assert found is None
        assert min(tried) == pytest.approx(capacity.LEAST * SMALL.ceiling)
    elif math.isinf(share):
        assert tried == [found.offered] == [SMALL.ceiling]
    else:
        assert most / 1.02 <= found.offered <= most
        assert len(tried) <= 12
