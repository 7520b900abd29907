"""Laws of arrival: their gaps, their rates, and what is refused."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy import integrate, stats

from surface_gym.flow.arrivals import FASTEST, Law, Poisson, Schedule, Spread, Steady, check_speed

LONG = 3600.0 * 20  # [s] for statistics
LOOSE = 1e-3  # a law is doubted below this p-value; the seeds are fixed
CHANGING = ((0.0, 600.0), (20.0, 0.0), (35.0, 2400.0), (50.0, 300.0))
LAWS = [
    Steady(1200.0), Spread(1200.0, 0.8), Poisson(1200.0, 0.5), Poisson(1200.0),
    Schedule(CHANGING), Schedule(CHANGING, spread=0.6),
]  # fmt: skip
LATE = ((0.0, 0.0), (7.0, 900.0))
every_law = pytest.mark.parametrize("law", LAWS, ids=repr)


def times(law: Law, duration: float = LONG, seed: int = 0) -> NDArray[np.float64]:
    return law.times(np.random.default_rng(seed), duration)


def gaps(law: Law) -> NDArray[np.float64]:
    return np.diff(times(law))


def due(rates: Any, time: float) -> float:
    """How many parcels a schedule expects by a time [s], by numerical integration."""
    start, rate = np.array(rates).T

    def of(moment: float) -> float:
        return rate[np.searchsorted(start, moment, side="right") - 1] / 3600.0

    return integrate.quad(of, 0.0, time, points=start[start < time], limit=200)[0]


@every_law
def test_the_seed_fixes_the_times(law: Law) -> None:
    np.testing.assert_array_equal(times(law, 60.0, seed=3), times(law, 60.0, seed=3))
    drawn = {times(law, 60.0, seed=seed).tobytes() for seed in range(3)}
    assert len(drawn) == (1 if law in (Steady(1200.0), Schedule(CHANGING)) else 3)


@every_law
@given(duration=st.floats(1e-3, 500.0), seed=st.integers(0, 1000))
def test_times_rise_from_nought_to_below_the_duration(law: Law, duration: float, seed: int) -> None:
    time = times(law, duration, seed)
    assert time[0] == 0.0
    assert time[-1] < duration
    assert (np.diff(time) >= 0.0).all()


@pytest.mark.parametrize(
    "law", [Steady(1200.0), Spread(1200.0, 0.0), Poisson(1200.0, least_gap=3.0)], ids=repr
)
def test_without_chance_the_gaps_are_equal_and_nobody_comes_at_the_very_end(law: Law) -> None:
    np.testing.assert_allclose(times(law, 59.999), 3.0 * np.arange(20))
    assert len(times(Steady(1200.0), 60.0)) == 20


def test_spread_gaps_are_uniform() -> None:
    gap = gaps(Spread(1200.0, 0.8))
    assert gap.min() >= 3.0 * 0.2 - 1e-9
    assert gap.max() <= 3.0 * 1.8 + 1e-9
    assert stats.kstest(gap, stats.uniform(0.6, 4.8).cdf).pvalue > LOOSE


@pytest.mark.parametrize("least_gap", [0.0, 0.5, 2.5])
def test_poisson_gaps_are_exponential_beyond_the_least(least_gap: float) -> None:
    gap = gaps(Poisson(1200.0, least_gap))
    assert gap.min() >= least_gap - 1e-9
    assert stats.kstest(gap, stats.expon(least_gap, 3.0 - least_gap).cdf).pvalue > LOOSE


def test_gaps_go_on_past_the_first_block() -> None:
    counts = []
    for seed in range(1000):
        time = times(Poisson(3600.0), 160.0, seed)
        sums = np.cumsum(np.random.default_rng(seed).standard_exponential(400))
        np.testing.assert_allclose(time, [0.0, *sums[sums < 160.0]])
        counts.append(len(time))
    assert max(counts) > 1.1 * 160 + 16  # the first block was short


@pytest.mark.parametrize("rates", [CHANGING, LATE, ((0.0, 1000.0),)])
def test_a_schedule_without_spread_comes_when_a_whole_number_is_due(rates: Any) -> None:
    time = times(Schedule(rates), 120.0)
    assert len(time) == math.ceil(due(rates, 120.0))
    for count, moment in enumerate(time):
        assert due(rates, float(moment)) == pytest.approx(count, abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_nobody_comes_at_a_rate_of_nought(seed: int) -> None:
    time = times(Schedule(CHANGING, spread=0.9), 120.0, seed)
    assert not ((time >= 20.0) & (time < 35.0)).any()
    assert times(Schedule(LATE, spread=0.9), 120.0, seed)[0] == 7.0
    assert [len(times(Schedule(LATE), duration)) for duration in (3.0, 7.0)] == [0, 0]
    np.testing.assert_allclose(times(Schedule(((0.0, 3600.0), (3.0, 0.0)))), [0.0, 1.0, 2.0])


def test_a_schedule_keeps_each_of_its_rates_and_is_a_spread_where_it_has_one() -> None:
    one, spread = Schedule(((0.0, 1200.0),), spread=0.7), Spread(1200.0, 0.7)
    np.testing.assert_allclose(times(one, 60.0), times(spread, 60.0))
    rates = ((0.0, 600.0), (0.25 * LONG, 1800.0), (0.5 * LONG, 0.0), (0.75 * LONG, 1200.0))
    seen, _ = np.histogram(times(Schedule(rates, spread=0.9)), bins=np.linspace(0.0, LONG, 5))
    np.testing.assert_allclose(seen, [3000, 9000, 0, 6000], rtol=0.04)


@pytest.mark.parametrize("speed", [0.0, -1.0, 5.1, math.nan, None])
def test_a_bad_speed_is_named(speed: Any) -> None:
    with pytest.raises(ValueError, match=r"^speed must be .*, got"):
        check_speed("speed", speed)
    assert check_speed("speed", FASTEST) == 5.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (3.1, "least_gap must be at most the mean gap, 3 s at a rate of 1200 parcels/h, got 3.1"),
        ((), r"rates must have the shape \(any, 2\), got \(0,\)"),
        (((0, 600), (5,)), "rates must be an array of numbers"),
        (((1, 600),), r"rates must be at times that rise from 0, got \[1.0\]"),
        (((0, 600), (5, 700), (5, 0)), "rates must be at times that rise from 0"),
        (((0, 600), (5, -1)), r"rates must be at least 0, and one of them greater, got \[600.0, "),
    ],
)
def test_a_bad_least_gap_or_schedule_is_refused(given: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        _ = Poisson(1200.0, given) if isinstance(given, float) else Schedule(given)
