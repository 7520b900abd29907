"""Rules of Sort."""

import numpy as np
import pytest

from tests.agents.rules.runs import run_rule

AFTER_THE_EVENT = ["event rule", "threshold logic", "PID per module"]


def starts(parcel: str, speed: float) -> list[dict]:
    return [{"parcel": parcel, "speed": speed, "side": side} for side in (1, -1)]


@pytest.mark.parametrize("name", AFTER_THE_EVENT)
@pytest.mark.parametrize(
    ("parcel", "speed"), [("S", 0.36), ("S", 0.4), ("S", 0.7), ("B", 0.52), ("B", 0.9)]
)
def test_they_sort_where_the_fixed_layout_stalls(name: str, parcel: str, speed: float) -> None:
    assert not run_rule("sort", "fixed layout", starts(parcel, speed)).success.any()
    assert run_rule("sort", name, starts(parcel, speed)).success.all()


@pytest.mark.parametrize("name", ["fixed layout", *AFTER_THE_EVENT])
@pytest.mark.parametrize("parcel", ["S", "B"])
def test_all_sort_a_fast_parcel(name: str, parcel: str) -> None:
    assert run_rule("sort", name, starts(parcel, 1.5)).success.all()


@pytest.mark.parametrize("name", ["fixed layout", *AFTER_THE_EVENT])
def test_straight_through_is_left_alone(name: str) -> None:
    runs = run_rule("sort", name, [{"parcel": "S", "speed": 1.5, "side": 0}])
    assert runs.outcome.tolist() == ["success"]
    np.testing.assert_allclose(runs.pose[:, 1:], [[1.0, 0.0]], atol=1e-6)
