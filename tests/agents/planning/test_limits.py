"""What cannot be done: where full braking ends, by the law of motion."""

import numpy as np
import pytest

from agents.planning.limits import stops_past
from surface_gym.layouts import box
from surface_gym.lines import Line
from surface_gym.settings import Settings
from surface_gym.tasks.line import BRAKING, zone_span

SEED = 3


def test_full_braking_ends_where_the_law_of_motion_says() -> None:
    """Half a pitch around where the box, as it comes in, is borne by the zone at last."""
    settings = Settings(task="stop", actions="halves")
    speeds = np.array([1.5, 2.0, 2.5])
    starts = [{"speed": speed, "position": 1.0, "parcel": "S"} for speed in speeds.tolist()]
    begins, _ = zone_span(Line(), box("S"), None)
    ends = 1.0 + stops_past(settings, starts, SEED)
    np.testing.assert_allclose(ends, begins + speeds**2 / (2.0 * BRAKING), atol=0.1)


def test_what_is_asked_counts() -> None:
    settings = Settings(task="stop", actions="halves", condition="lab")
    near, far = (
        stops_past(settings, [{"speed": 2.0, "position": 1.0}], SEED),
        stops_past(settings, [{"speed": 2.0, "position": 1.5}], SEED),
    )
    np.testing.assert_allclose(near - far, 0.5)


def test_other_tasks_are_an_error() -> None:
    with pytest.raises(ValueError, match="task must be one of 'stop'"):
        stops_past(Settings(task="slow", actions="halves"), [{}], SEED)


def test_other_actions_are_an_error() -> None:
    with pytest.raises(ValueError, match="actions must be one of 'halves'"):
        stops_past(Settings(task="stop", actions="modules"), [{}], SEED)
