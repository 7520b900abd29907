"""Rates that are sustained: measuring one, and the search for the greatest."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.evaluation import capacity
from surface_gym.agents.evaluation.benchmark import half_interval
from surface_gym.agents.evaluation.capacity import Measurement
from surface_gym.agents.evaluation.methods import FIXED
from surface_gym.agents.evaluation.streams import EVENT, RESERVATION, stream_methods
from surface_gym.config import EnvConfig

SMALL = capacity.Case("S", 1.5)
NOBODY: Any = None  # decides where the measurement is replaced
BY_NAME = {method.name: method for method in stream_methods()}


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capacity, "REPLICATIONS", 4)


def offer(
    method: capacity.StreamMethod, case: capacity.Case, rate: float, whole: bool = True
) -> Measurement | None:
    controller = method.make(method.config(case, rate))
    assert controller is not None
    return capacity.measure(method, controller, case, rate, whole)


def delivery(
    offered: float, right: int = 1000, delivered: int = 1000, jams: int = 0
) -> Measurement:
    return Measurement(offered, [right], [delivered], [0.0], [0.0], jams, 20.0)


class TestMeasurement:
    def test_figures_are_those_of_all_replications(self) -> None:
        found = Measurement(3000.0, [10, 12], [10, 15], [1.0, 0.0], [0.2, 0.4], 0, 20.0)
        assert found.rates.tolist() == [1800.0, 2160.0]
        assert found.rate == pytest.approx(1980.0)
        assert found.share_right == pytest.approx(22 / 25)
        assert found.touches_per_1000 == pytest.approx(40.0)
        assert found.waited == pytest.approx(0.3)
        # Two values: half the interval is 12.706 of the mean's standard error.
        assert found.margin == pytest.approx(12.706 * 180.0, rel=1e-4)

    def test_the_interval_holds_the_mean_as_often_as_it_says(self) -> None:
        rng = np.random.default_rng(0)
        samples = rng.normal(size=(2000, 30))
        within = [abs(values.mean()) <= half_interval(values) for values in samples]
        assert np.mean(within) == pytest.approx(0.95, abs=0.015)

    @pytest.mark.parametrize(
        ("preset", "right", "jams", "expected"),
        [
            ("exact", 999, 0, True), ("exact", 998, 0, False), ("exact", 1000, 1, False),
            ("camera", 995, 0, True), ("camera", 994, 0, False),
        ],
    )  # fmt: skip
    def test_what_is_sustained(self, preset, right, jams, expected) -> None:
        case = replace(SMALL, preset=preset)
        assert delivery(3000.0, right, jams=jams).is_sustained(case) is expected

    def test_nothing_delivered_is_not_sustained(self) -> None:
        assert not delivery(3000.0, 0, 0).is_sustained(SMALL)


@pytest.mark.parametrize("rate", [500.0, 1234.0, 3600.0, 20000.0])
def test_what_counts_are_whole_gaps_after_the_warm_up(rate) -> None:
    counted = capacity.counted_time(30.0, rate)
    gaps = counted * rate / 3600.0
    assert gaps == pytest.approx(round(gaps))
    assert 22.0 - 3600.0 / rate < counted <= 22.0 + 1e-9


def test_one_gap_counts_at_least() -> None:
    assert capacity.counted_time(30.0, 150.0) == pytest.approx(24.0)
    assert capacity.counted_time(30.0, 10.0) == 30.0


class TestMeasure:
    @pytest.mark.parametrize("name", [EVENT, RESERVATION])
    def test_what_comes_leaves_in_the_long_run(self, name) -> None:
        """To the parcel, as whole gaps count: every replication delivers what was offered."""
        found = offer(BY_NAME[name], SMALL, 3000.0)
        assert found.share_right == 1.0
        assert found.rates == pytest.approx(3000.0, rel=0.12)
        assert found.rate == pytest.approx(3000.0, rel=0.03)
        assert found.jams == 0

    def test_the_same_twice(self) -> None:
        assert offer(BY_NAME[EVENT], SMALL, 9000.0) == offer(BY_NAME[EVENT], SMALL, 9000.0)

    def test_every_method_meets_the_same_stream(self) -> None:
        """A third of it is to go left: so many the layout has right, and the rule by all exits."""
        layout = offer(BY_NAME[FIXED], SMALL, 3000.0)
        rule = offer(BY_NAME[EVENT], SMALL, 3000.0)
        assert layout.delivered == pytest.approx(rule.delivered, abs=2)
        assert 0.15 < layout.share_right < 0.55

    def test_a_lost_rate_is_broken_off(self) -> None:
        assert offer(BY_NAME[FIXED], SMALL, 3000.0, whole=False) is None

    def test_a_jam_is_told(self) -> None:
        class Brake:
            """Every axis at 0 deg."""

            def __init__(self, config: EnvConfig) -> None:
                self._size = config.action_kind.size

            def predict(self, observation: Any, state: Any = None, *_: Any) -> tuple[Any, Any]:
                return np.zeros((len(observation), self._size), dtype=int), state

        brake = capacity.StreamMethod("brake", "modules", False, Brake)
        whole = offer(brake, SMALL, 9000.0)
        assert whole.jams == 4
        assert whole.rate == 0.0
        assert whole.waiting == pytest.approx([0.0] * 4)
        assert not whole.is_sustained(SMALL)


class TestSearch:
    """With a measurement that knows the greatest rate."""

    def search(
        self, monkeypatch: pytest.MonkeyPatch, most: float, name: str = RESERVATION
    ) -> tuple[Measurement | None, list[float]]:
        tried: list[float] = []

        def known(_: Any, __: Any, ___: Any, rate: float, whole: bool = True) -> Measurement | None:
            assert not whole
            tried.append(rate)
            return delivery(rate) if rate <= most else delivery(rate, right=500)

        monkeypatch.setattr(capacity, "measure", known)
        return capacity.find_capacity(BY_NAME[name], NOBODY, SMALL), tried

    def test_the_ceiling_comes_first(self, monkeypatch) -> None:
        found, tried = self.search(monkeypatch, math.inf)
        assert tried == [found.offered] == [SMALL.ceiling]

    @pytest.mark.parametrize("carried", [5000.0, 9000.0, 17000.0])
    def test_without_a_gate_more_may_be_delivered_where_fewer_come(
        self, monkeypatch, carried
    ) -> None:
        """Beyond what is carried parcels hinder each other: less is delivered the more come."""

        def known(_: Any, __: Any, ___: Any, rate: float, whole: bool = True) -> Measurement | None:
            del whole
            delivered = rate if rate <= carried else carried - 0.1 * (rate - carried)
            right = round(delivered * 1000.0)
            return Measurement(rate, [right], [right], [0.0], [0.0], 0, 3600.0 * 1000.0)

        monkeypatch.setattr(capacity, "measure", known)
        found = capacity.find_capacity(BY_NAME[EVENT], NOBODY, SMALL)
        assert carried / 1.03 <= found.rate <= carried

    @pytest.mark.parametrize("share", [0.99, 0.7, 0.3, 0.07])
    def test_it_comes_within_two_in_a_hundred(self, monkeypatch, share) -> None:
        most = share * SMALL.ceiling
        found, tried = self.search(monkeypatch, most)
        assert most / 1.02 <= found.offered <= most
        assert len(tried) <= 12

    def test_below_the_least_rate_there_is_no_capacity(self, monkeypatch) -> None:
        found, tried = self.search(monkeypatch, 0.9 * capacity.LEAST * SMALL.ceiling)
        assert found is None
        assert min(tried) == pytest.approx(capacity.LEAST * SMALL.ceiling)
