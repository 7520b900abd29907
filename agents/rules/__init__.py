"""Controllers that do not learn."""

from agents.rules.braking import SlowingRule, StoppingRule
from agents.rules.event import EventRule
from agents.rules.fixed import FixedLayout
from agents.rules.fixed_braking import FixedSlowing, FixedStopping
from agents.rules.fixed_turning import FixedTurning
from agents.rules.pid import PidRule
from agents.rules.rolling import Rolling
from agents.rules.rule import Rule
from agents.rules.sliding_mode import SlidingMode
from agents.rules.threshold import ThresholdRule
from agents.rules.turning import TurningRule

RULES = (
    Rule("fixed layout", "sort", "modules", FixedLayout),
    Rule("event rule", "sort", "halves", EventRule),
    Rule("threshold logic", "sort", "modules", ThresholdRule),
    Rule("PID per module", "sort", "modules", PidRule),
    Rule("fixed layout", "slow", "modules", FixedSlowing),
    Rule("braking rule", "slow", "modules", SlowingRule),
    Rule("fixed layout", "stop", "modules", FixedStopping),
    Rule("braking rule", "stop", "modules", StoppingRule),
    Rule("fixed layout", "track", "window", Rolling),
    Rule("threshold logic", "track", "window", ThresholdRule),
    Rule("PID per module", "track", "window", PidRule),
    Rule("sliding mode", "track", "window", SlidingMode),
    Rule("fixed layout", "orient", "modules", FixedTurning),
    Rule("threshold logic", "orient", "modules", ThresholdRule),
    Rule("PID per module", "orient", "modules", PidRule),
    Rule("turning rule", "orient", "modules", TurningRule),
)
