"""Rates that are sustained: measuring one, and the search for the greatest."""

import math
from collections.abc import Callable
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


def test_figures_are_those_of_all_replications() -> None:
    found = Measurement(3000.0, [10, 12], [10, 15], [1.0, 0.0], [0.2, 0.4], 0, 20.0)
    assert found.rates.tolist() == [1800.0, 2160.0]
    assert found.rate == pytest.approx(1980.0)
    assert found.share_right == pytest.approx(22 / 25)
    assert found.touches_per_1000 == pytest.approx(40.0)
    assert found.waited == pytest.approx(0.3)
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


class TestMeasure:
    @pytest.mark.parametrize("name", [EVENT, RESERVATION])
    def test_what_comes_leaves_in_the_long_run(self, name) -> None:
        """To the parcel, as whole gaps count: every replication delivers what was offered."""
        found = offer(BY_NAME[name], SMALL, 3000.0)
        assert found == offer(BY_NAME[name], SMALL, 3000.0)
        assert found.share_right == 1.0
        assert found.rates == pytest.approx(3000.0, rel=0.12)
        assert found.rate == pytest.approx(3000.0, rel=0.03)
        assert found.jams == 0

    def test_every_method_meets_the_same_stream(self) -> None:
        """A third of it is to go left: so many the layout has right, and the rule by all exits."""
        layout = offer(BY_NAME[FIXED], SMALL, 3000.0)
        rule = offer(BY_NAME[EVENT], SMALL, 3000.0)
        assert layout.delivered == pytest.approx(rule.delivered, abs=2)
        assert 0.15 < layout.share_right < 0.55
        # A lost rate is broken off.
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


def search(
    monkeypatch: pytest.MonkeyPatch, name: str, known: Callable[[float], Measurement]
) -> tuple[Measurement | None, list[float]]:
    """The greatest rate, and all that were tried, where a measurement is known by its rate."""
    tried: list[float] = []

    def measure(_: Any, __: Any, ___: Any, rate: float, whole: bool = True) -> Measurement:
        assert name == EVENT or not whole
        tried.append(rate)
        return known(rate)

    monkeypatch.setattr(capacity, "measure", measure)
    return capacity.find_capacity(BY_NAME[name], NOBODY, SMALL), tried


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
