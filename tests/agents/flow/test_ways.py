"""The ways of single parcels."""

import numpy as np
import pytest

from agents.flow.event import EventRule
from agents.flow.ways import asked_of, ways_of
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Camera
from tests.agents.flow.lines import line
from tests.flow.flows import BOX, trace


def test_every_parcel_speed_and_exit_is_asked_for() -> None:
    stream = Stream(Steady(1000.0), parcels=("S", "B"), destinations={"left": 1.0})
    asked = asked_of(line(stream))
    assert [(parcel.base.length, speed, name) for parcel, speed, name in asked] == [
        (0.25, 1.5, "left"), (0.45, 1.5, "left"),
    ]  # fmt: skip


def test_of_speeds_that_vary_some_are() -> None:
    stream = Stream(Steady(1000.0), speeds=(1.0, 1.25))
    speeds = sorted({speed for _, speed, _ in asked_of(line(stream))})
    assert (speeds[0], speeds[-1]) == (1.0, 1.25)
    assert max(np.diff(speeds)) <= 0.1 + 1e-9
    assert {name for _, _, name in asked_of(line(stream))} == {"left", "right", "straight"}


def test_of_a_trace_each_is_asked_for_once() -> None:
    stream = trace((0.0, "left"), (1.0, "right"), (2.0, "left"))
    assert asked_of(line(stream)) == [(BOX, 1.5, "left"), (BOX, 1.5, "right")]


def test_ways_lead_to_the_exits_and_are_mirror_images() -> None:
    settings = line(Stream(Steady(1000.0), speeds=1.5))
    found = ways_of(EventRule, settings, asked_of(settings))
    assert found.right == (True, True, True)
    left, right, straight = found.ways
    middle = settings.chosen_plant.line_y
    np.testing.assert_allclose(left.pose[:, 1] - middle, middle - right.pose[:, 1], atol=1e-9)
    np.testing.assert_allclose(left.time, right.time)
    np.testing.assert_allclose(straight.pose[:, 1], middle, atol=1e-9)
    assert straight.pose[-1, 0] > settings.rotors_end
    for way in found.ways:
        assert way.time[0] >= 0.0
        assert (np.diff(way.time) > 0.0).all()
        assert way.outline.shape == (len(BOX.base.outline), 2)


def test_they_are_those_of_exact_sensors_whatever_varies() -> None:
    settings = line(Stream(Steady(1000.0), speeds=1.5))
    asked = asked_of(settings)
    exact = ways_of(EventRule, settings, asked)
    seen = line(
        settings.stream, sensors=Camera(), randomisation=Randomisation(friction=0.2), gate=True
    )
    for one, other in zip(exact.ways, ways_of(EventRule, seen, asked).ways, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)


def test_signatures_tell_them_apart() -> None:
    settings = line(Stream(Steady(1000.0), parcels=("S", "B"), speeds=(1.0, 1.2)))
    signature = ways_of(EventRule, settings, asked_of(settings)).signature
    apart = np.abs(signature[:, None] - signature[None]).max(axis=2)
    assert apart[~np.eye(len(apart), dtype=bool)].min() > 0.05


@pytest.mark.parametrize("speed", [0.05])
def test_who_comes_to_rest_is_not_right(speed: float) -> None:
    settings = line(Stream(Steady(1000.0), speeds=speed), duration=3.0)
    found = ways_of(EventRule, settings, asked_of(settings))
    assert found.right == (False, False, False)
