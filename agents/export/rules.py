"""Rules of one parcel for the playground: what `page/rules.js` has to know of each.

A rule's card holds its kind, what it sees of its environment, and its numbers. The page computes
what the rule does; tests hold both to the same runs.
"""

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.core import actions
from surface_gym.lines import Line
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks import base as tasks, track

from ..base import find_axes
from ..rules import RULES, base, braking, local, sorting, steering

Card = dict[str, Any]


def describe_rules(task: str) -> dict[str, Card]:
    """Describe a task's rules that choose anew each control period, by name."""
    found = {}
    for rule in RULES:
        describe = DESCRIBED.get(rule.make)
        if rule.task == task and describe is not None:
            config = EnvConfig(task, actions=rule.actions)
            found[rule.name] = {**_describe_seen(config), **describe(config)}
    return found


def _describe_seen(config: EnvConfig) -> Card:
    """Describe what every rule needs: its observation, its modules and its choices."""
    line, kind = config.chosen_line, config.action_kind
    angles = np.array(config.chosen_orientations)
    return {
        "actions": config.actions,
        # Those of the page's environment: a rule needs no other.
        "features": [feature.name for feature in EnvConfig(config.task_name).features],
        "slopes": [f"slope {ahead:g} m ahead" for ahead in track.AHEAD],
        "pitch": [line.pitch_x, line.pitch_y],
        "zoneLength": line.pitch_x * line.zone_columns,
        "rows": kind.shape[0],
        "columns": kind.shape[1],
        "axes": asdict(find_axes(config)),
        "directions": np.stack([np.cos(angles), np.sin(angles)], axis=-1).tolist(),
        "period": config.control_period,
        "midway": steering.MIDWAY,
        "justOver": actions.JUST_OVER_HALF,
        "gravity": GRAVITY,
        "braking": tasks.BRAKING,
    }


def _describe_event(config: EnvConfig) -> Card:
    del config
    return {"kind": "event"}


def _describe_local(kind: str) -> Callable[[EnvConfig], Card]:
    def describe(config: EnvConfig) -> Card:
        task = local.LOCAL_TASKS[config.task_name]
        return {
            "kind": kind, "task": config.task_name,
            "thresholds": task.thresholds, "gains": task.gains,
            "aside": local.ASIDE, "centring": local.CENTRING, "crossing": local.CROSSING,
            "straightening": local.STRAIGHTENING, "turning": local.TURNING,
            "endOfTurn": local.END_OF_TURN, "closeEnough": local.CLOSE_ENOUGH,
            "mostSummed": local.MOST_SUMMED,
        }  # fmt: skip

    return describe


def _describe_sliding(config: EnvConfig) -> Card:
    return {
        "kind": "sliding", "steps": steering.STEPS,
        "options": steering.leading_options(config).tolist(), "ahead": track.AHEAD[1],
        "surfaceSlope": steering.SLOPE, "speedWeight": steering.SPEED_WEIGHT,
        "turnWeight": steering.TURN_WEIGHT, "straightening": steering.STRAIGHTENING,
    }  # fmt: skip


def _describe_turning(config: EnvConfig) -> Card:
    del config
    return {
        "kind": "turning", "steps": steering.STEPS, "from": steering.FROM.tolist(),
        "endOfTurn": steering.END_OF_TURN, "speedWorth": steering.SPEED_WORTH,
        "driftWorth": steering.DRIFT_WORTH, "closeEnough": steering.CLOSE_ENOUGH,
        "worthIt": steering.WORTH_IT,
    }  # fmt: skip


def _describe_braking(kind: str, gently: float) -> Callable[[EnvConfig], Card]:
    def describe(config: EnvConfig) -> Card:
        rows, _ = config.action_kind.shape
        levels = np.arange(len(base.LEANS))[:, np.newaxis]
        half = base.LEANS[base.HALF]
        return {
            "kind": kind, "gently": gently, "dt": config.timing.dt, "steps": config.timing.steps,
            "choices": base.ColumnAxes(config)(levels).reshape(len(levels), rows).tolist(),
            "leans": np.stack([np.cos(base.LEANS), np.sin(base.LEANS)], axis=-1).tolist(),
            "half": [math.cos(half), math.sin(half)],
            "isNarrow": isinstance(config.chosen_line, Line), "onEdge": braking.ON_EDGE,
            "rollingLoss": tasks.ROLLING_LOSS, "supportLoss": braking.SUPPORT_LOSS,
            "comHeight": braking.COM_HEIGHT, "short": braking.SHORT, "caution": braking.CAUTION,
            "trimTime": braking.TRIM_TIME, "unsure": braking.UNSURE.tolist(),
            "least": braking.LEAST, "most": braking.MOST, "predicted": braking.PREDICTED,
            "noises": [braking.SEEN_EXACTLY, braking.SEEN],
        }  # fmt: skip

    return describe


# How each rule is described; layouts and others are described by what they choose.
DESCRIBED: dict[Callable[[EnvConfig], Any], Callable[[EnvConfig], Card]] = {
    sorting.EventRule: _describe_event,
    local.ThresholdRule: _describe_local("threshold"),
    local.PidRule: _describe_local("pid"),
    steering.SlidingMode: _describe_sliding,
    steering.TurningRule: _describe_turning,
    braking.SlowingRule: _describe_braking("slowing", braking.SLOW_GENTLY),
    braking.StoppingRule: _describe_braking("stopping", braking.STOP_GENTLY),
}
