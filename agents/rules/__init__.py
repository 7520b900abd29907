"""Controllers that do not learn."""

import math
from functools import partial

from .best_layout import BestSlowing, BestStopping, BestTurning
from .best_sorting import BestSorting
from .braking import SlowingRule, StoppingRule
from .event import EventRule
from .fixed import FixedLayout
from .fixed_braking import FixedSlowing, FixedStopping
from .fixed_turning import FixedTurning
from .pid import PidRule
from .rolling import Rolling
from .rule import Rule
from .sliding_mode import SlidingMode
from .threshold import ThresholdRule
from .turning import TurningRule
from .uniform import UniformLayout

# The outline: how wide a base is, how round; and what sensors learn of friction and of the load.
BRAKING = ("parcel", "load")

RULES = (
    Rule("fixed layout", "sort", "modules", FixedLayout),
    Rule("best fixed layout", "sort", "modules", BestSorting),
    Rule("event rule", "sort", "halves", EventRule),
    Rule("threshold logic", "sort", "modules", ThresholdRule),
    Rule("PID per module", "sort", "modules", PidRule),
    Rule("fixed layout", "slow", "modules", FixedSlowing),
    Rule("best fixed layout", "slow", "modules", BestSlowing),
    Rule("braking rule", "slow", "modules", SlowingRule, BRAKING),
    Rule("fixed layout", "stop", "modules", FixedStopping),
    Rule("best fixed layout", "stop", "modules", BestStopping),
    Rule("braking rule", "stop", "modules", StoppingRule, BRAKING),
    Rule("fixed layout", "track", "window", Rolling),
    Rule("threshold logic", "track", "window", ThresholdRule),
    Rule("PID per module", "track", "window", PidRule),
    Rule("sliding mode", "track", "window", SlidingMode),
    Rule("fixed layout", "orient", "modules", FixedTurning),
    Rule("best fixed layout", "orient", "modules", BestTurning),
    Rule("threshold logic", "orient", "modules", ThresholdRule),
    Rule("PID per module", "orient", "modules", PidRule),
    Rule("turning rule", "orient", "modules", TurningRule),
)


def rules_of(kind: str) -> list[Rule]:
    """Those of a task of the package; of any other, layouts of axes that are all alike, the
    conveyor's for the fixed one.
    """
    chosen = [rule for rule in RULES if rule.task == kind]
    if chosen:
        return chosen
    layouts = {"fixed layout": 90.0, "all at 0 deg": 0.0, "all at 45": 45.0, "all at -45": -45.0}
    return [
        Rule(name, kind, "halves", partial(UniformLayout, angle=math.radians(angle)))
        for name, angle in layouts.items()
    ]
