"""Controllers that do not learn."""

import math
from functools import partial

from surface_gym.core.actions import ANY

from ..planning.layouts import ShownPath
from . import braking, layouts, local, sorting, steering
from .base import Rule, UniformLayout

__all__ = ["MORE_RULES", "ROLLING", "RULES", "Rule", "find_rules"]

# The outline: how wide a base is, how round; and what sensors learn of friction and of the load.
BRAKING = ("parcel", "load")
# On a field every axis at 90 deg: a parcel rolls straight downhill. A field arranged along a path
# would have to know the path, of which observations show the next 0.35 m.
ROLLING = partial(UniformLayout, angle=math.pi / 2.0, tasks=("track",))

RULES = (
    Rule("fixed layout", "sort", "modules", sorting.FixedLayout),
    Rule("best fixed layout", "sort", "modules", sorting.BestSorting),
    Rule("event rule", "sort", "halves", sorting.EventRule),
    Rule("threshold logic", "sort", "modules", local.ThresholdRule),
    Rule("PID per module", "sort", "modules", local.PidRule),
    Rule("fixed layout", "slow", "modules", layouts.FixedSlowing),
    Rule("best fixed layout", "slow", "modules", layouts.BestSlowing, searches=True),
    Rule("braking rule", "slow", "modules", braking.SlowingRule, BRAKING),
    Rule("fixed layout", "stop", "modules", layouts.FixedStopping),
    Rule("best fixed layout", "stop", "modules", layouts.BestStopping, searches=True),
    Rule("braking rule", "stop", "modules", braking.StoppingRule, BRAKING),
    Rule("fixed layout", "track", "window", ROLLING),
    Rule("threshold logic", "track", "window", local.ThresholdRule),
    Rule("PID per module", "track", "window", local.PidRule),
    Rule("sliding mode", "track", "window", steering.SlidingMode),
    Rule("fixed layout", "orient", "modules", layouts.FixedTurning),
    Rule("best fixed layout", "orient", "modules", layouts.BestTurning, searches=True),
    Rule("threshold logic", "orient", "modules", local.ThresholdRule),
    Rule("PID per module", "orient", "modules", local.PidRule),
    Rule("turning rule", "orient", "modules", steering.TurningRule),
)

# Rules in environments of their own: the whole path in the observation, axes at any angle.
MORE_RULES = (
    Rule(
        "best fixed layout",
        "track",
        "modules",
        layouts.BestTracking,
        searches=True,
        observed_task=ShownPath.of,
    ),
    Rule("fixed layout, any angle", "sort", "modules", sorting.GradedLayout, orientations=ANY),
)


def find_rules(task: str) -> list[Rule]:
    """List the rules of a task of the package; of any other task, layouts of axes that are all
    alike, the conveyor's for the fixed one.
    """
    chosen = [rule for rule in RULES if rule.task == task]
    if chosen:
        return chosen
    angles = {"fixed layout": 90.0, "all at 0 deg": 0.0, "all at 45": 45.0, "all at -45": -45.0}
    return [
        Rule(name, task, "halves", partial(UniformLayout, angle=math.radians(angle)))
        for name, angle in angles.items()
    ]
