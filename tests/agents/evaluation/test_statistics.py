"""Intervals of success rates, against SciPy's and against simulation."""

import numpy as np
import pytest
from scipy.stats import binomtest

from surface_gym.agents.evaluation.benchmark import interval, wilson


@pytest.mark.parametrize(("successes", "count"), [(0, 20), (7, 20), (20, 20), (480, 500)])
def test_one_seed_has_wilsons_interval(successes, count) -> None:
    known = binomtest(successes, count).proportion_ci(method="wilson")
    assert wilson(successes / count, count) == pytest.approx((known.low, known.high), abs=1e-12)
    found = interval(np.arange(count)[np.newaxis] < successes)
    # A sample's spread counts one start less.
    assert found == pytest.approx((known.low, known.high), abs=0.01)


def test_round_off_takes_no_interval_beyond_what_a_share_can_be() -> None:
    for count in range(1, 100):
        for share in (0.0, 1.0):
            low, high = wilson(share, count)
            assert 0.0 <= low <= high <= 1.0


def test_seeds_alike_are_no_surer_than_one() -> None:
    """The same starts again say nothing new."""
    one = np.random.default_rng(0).random((1, 400)) < 0.9
    assert interval(np.repeat(one, 3, axis=0)) == pytest.approx(interval(one), abs=1e-12)


def test_a_seed_that_fails_widens_it() -> None:
    good, bad = np.ones((1, 500), bool), np.zeros((1, 500), bool)
    low, high = interval(np.concatenate([good, good, bad]))
    assert low < 0.2
    assert high > 0.9


def test_it_holds_the_truth_about_as_often_as_it_says() -> None:
    """Seeds and starts of their own difficulty, drawn anew many times."""
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(400):
        chance = 0.8 + 0.05 * rng.standard_normal((5, 1)) + 0.1 * rng.standard_normal((1, 200))
        low, high = interval(rng.random((5, 200)) < chance)
        held += low <= 0.8 <= high
    assert held / 400 > 0.88
