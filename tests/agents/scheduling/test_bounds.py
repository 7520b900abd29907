"""Bounds on what a schedule can carry."""

import numpy as np
import pytest

from surface_gym.agents.scheduling.maneuvers import make_library
from surface_gym.agents.scheduling.scheduler import clairvoyant_bound, entrance_bound
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from tests.agents.rules.runs import counts, gated


class Everybody:
    """Lets in whoever finds room, and lets all roll straight on."""

    def predict(self, observation, state=None, *_, **__):
        action = np.full((len(observation), 49), 3)
        action[:, -1] = 1
        return action, state


@pytest.mark.parametrize(
    ("stream", "rate"),
    [
        (Stream(Steady(20000.0), parcels=("S",), speeds=1.5), 20000.0),
        (Stream(Steady(20000.0), parcels=("S", "B"), speeds=1.0), 3600.0 / 0.37),
    ],
    ids=["S", "S and B"],
)
def test_no_more_come_through_an_entrance_and_nearly_as_many_do(stream, rate) -> None:
    config = gated(stream, duration=20.0, max_parcels=24)
    assert entrance_bound(config) == pytest.approx(rate)
    straight = config.replace(
        stream=Stream(stream.arrivals, stream.parcels, {"straight": 1.0}, stream.speeds)
    )
    count = counts(Everybody(), straight, num_envs=8)
    delivered = 3600.0 * count["right"] / (8 * (20.0 - 2.0 / 1.5))
    assert 0.85 * rate < delivered < 1.03 * rate


def test_odds_count() -> None:
    config = gated(Stream(Steady(1000.0), parcels=("S", "B"), speeds=1.5))
    only_small = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    assert entrance_bound(config, only_small) == pytest.approx(20000.0)


def test_the_shortest_path_is_found() -> None:
    library = make_library(gated(Stream(Steady(1000.0), speeds=1.5)), place_count=2)
    bound = clairvoyant_bound(library, np.ones(3), parcels=4, seed=3)
    kinds = np.random.default_rng(3).choice(3, size=4, p=np.ones(3) / 3.0)
    own = [library.options[kind][library.options[kind] >= 0] for kind in kinds]
    least = min(
        library.gaps[a, b] + library.gaps[b, c] + library.gaps[c, d]
        for a in own[0] for b in own[1] for c in own[2] for d in own[3]
    )  # fmt: skip
    assert bound == pytest.approx(3600.0 * 3 / least)
