"""Controllers that do not learn."""

import math
from functools import partial

from surface_gym.core.actions import ANY

from ..planning.layouts import ShownPath
from .base import Rule, UniformLayout
from .braking import SlowingRule, StoppingRule
from .layouts import (
    BestSlowing,
    BestStopping,
    BestTracking,
    BestTurning,
    FixedSlowing,
    FixedStopping,
    FixedTurning,
)
from .local import PidRule, ThresholdRule
from .sorting import BestSorting, EventRule, FixedLayout, GradedLayout
from .steering import SlidingMode, TurningRule

__all__ = ["MORE_RULES", "ROLLING", "RULES", "Rule", "find_rules"]

# The outline: how wide a base is, how round; and what sensors learn of friction and of the load.
BRAKING = ("parcel", "load")
# On a field every axis at 90 deg: a parcel rolls straight downhill. A field arranged along a path
# would have to know the path, of which observations show the next 0.35 m.
ROLLING = partial(UniformLayout, angle=math.pi / 2.0, tasks=("track",))

RULES = (
    Rule("fixed layout", "sort", "modules", FixedLayout),
    Rule("best fixed layout", "sort", "modules", BestSorting),
    Rule("event rule", "sort", "halves", EventRule),
    Rule("threshold logic", "sort", "modules", ThresholdRule),
    Rule("PID per module", "sort", "modules", PidRule),
    Rule("fixed layout", "slow", "modules", FixedSlowing),
    Rule("best fixed layout", "slow", "modules", BestSlowing, searches=True),
    Rule("braking rule", "slow", "modules", SlowingRule, BRAKING),
    Rule("fixed layout", "stop", "modules", FixedStopping),
    Rule("best fixed layout", "stop", "modules", BestStopping, searches=True),
    Rule("braking rule", "stop", "modules", StoppingRule, BRAKING),
    Rule("fixed layout", "track", "window", ROLLING),
    Rule("threshold logic", "track", "window", ThresholdRule),
    Rule("PID per module", "track", "window", PidRule),
    Rule("sliding mode", "track", "window", SlidingMode),
    Rule("fixed layout", "orient", "modules", FixedTurning),
    Rule("best fixed layout", "orient", "modules", BestTurning, searches=True),
    Rule("threshold logic", "orient", "modules", ThresholdRule),
    Rule("PID per module", "orient", "modules", PidRule),
    Rule("turning rule", "orient", "modules", TurningRule),
)

# Rules in environments of their own: the whole path in the observation, axes at any angle.
MORE_RULES = (
    Rule(
        "best fixed layout",
        "track",
        "modules",
        BestTracking,
        searches=True,
        observed_task=ShownPath.of,
    ),
    Rule("fixed layout, any angle", "sort", "modules", GradedLayout, orientations=ANY),
)


def find_rules(task: str) -> list[Rule]:
    """List the rules of a task of the package; of any other task, layouts of axes that are all
    alike, the conveyor's for the fixed one.
    """
    chosen = [rule for rule in RULES if rule.task == task]
    if chosen:
        return chosen
    layouts = {"fixed layout": 90.0, "all at 0 deg": 0.0, "all at 45": 45.0, "all at -45": -45.0}
    return [
        Rule(name, task, "halves", partial(UniformLayout, angle=math.radians(angle)))
        for name, angle in layouts.items()
    ]
