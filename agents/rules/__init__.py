"""Rules by task. A rule is a controller without learning."""

import math
from functools import partial

from .base import MODULES, ROLLING, RULES, Rule, UniformLayout, rule

__all__ = [
    "BEST_RULES",
    "ROLLING",
    "RULES",
    "Rule",
    "find_apart",
    "find_prior",
    "find_rules",
    "rule",
]

# The best rule of each task by the benchmark.
BEST_RULES = {
    "sort": "event rule", "slow": "braking rule", "stop": "braking rule", "track": "sliding mode",
    "orient": "turning rule", "park": "parking rule", "flow": "event rule",
    "singulate": "patterns", "merge": "patterns", "sequence": "pass and park",
}  # fmt: skip


def find_apart() -> list[Rule]:
    """Return rules that observe the whole path, and rules whose axes can take any angle."""
    return [each for each in RULES.values() if each.is_apart]


def find_prior(task: str) -> Rule | None:
    """Return the rule that PPO per parcel corrects on a task, or None if the task has no rule."""
    return next((each for each in RULES.values() if each.task == task and each.is_prior), None)


def find_rules(task: str) -> list[Rule]:
    """Return the rules of a task, without the rules that `find_apart` returns.

    If a task has no rules, return fixed layouts. All axes of a fixed layout have the same angle.
    This angle is 90 deg in the first layout.
    """
    chosen = [each for each in RULES.values() if each.task == task and not each.is_apart]
    if chosen:
        return sorted(chosen, key=_place)  # whichever module was imported first
    angles = {"fixed layout": 90.0, "all at 0 deg": 0.0, "all at 45": 45.0, "all at -45": -45.0}
    return [
        Rule(name, task, "halves", partial(UniformLayout, angle=math.radians(angle)))
        for name, angle in angles.items()
    ]


def _place(rule: Rule) -> int:
    """Return the index of a rule's module in `MODULES`, or len(MODULES) for other modules."""
    made = rule.make.func if isinstance(rule.make, partial) else rule.make
    module = getattr(made, "__module__", "")
    return MODULES.index(module) if module in MODULES else len(MODULES)
