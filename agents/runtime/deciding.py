"""Who decides: the policy, or the fixed layout while there is nothing to decide by."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.layouts import ROLLING
from surface_gym.settings import Settings

from ..controller import Controller
from ..rules import rules_of
from ..rules.rule import Rule
from .axis_guard import within_right_angles

Command = NDArray[Any]  # (size,) choices, or angles [rad]
Observation = NDArray[np.float32]  # (features,)


class Decider:
    """A controller that decides for one parcel after the other.

    Args:
        controller: decides.
        settings: of the environment that it is for.
    """

    def __init__(self, controller: Controller, settings: Settings) -> None:
        self._controller = controller
        self.kind = settings.action_kind
        self._state: Any = None
        self._begins = True

    def begin(self) -> None:
        """A parcel has just entered."""
        self._state, self._begins = None, True

    def decide(self, observation: Observation) -> Command:
        """The command for an observation.

        Raises:
            ValueError: the controller gave what is no action.
        """
        action, self._state = self._controller.predict(
            observation[np.newaxis],
            self._state,
            episode_start=np.array([self._begins]),
            deterministic=True,
        )
        self._begins = False
        command: Command = self.kind.commands(action, 1)[0]
        return command


class FixedLayouts:
    """The fixed layout of a task, arranged for each parcel by what is known of it as it enters.

    Args:
        settings: of the policy's environment.
    """

    def __init__(self, settings: Settings) -> None:
        rule = fixed_rule(settings)
        own = replace(settings, actions=rule.actions, observe=(), observe_axes=False)
        self._decider = Decider(rule.make(own), own)
        self._own = len(own.chosen_task.features)
        self._features = len(own.features)
        self.kind = self._decider.kind

    def arrange(self, observation: Observation) -> Command:
        """The command of a parcel that has just entered, by an observation of the policy's: of it
        the task's own features count, which come first in every observation.
        """
        shown = np.zeros(self._features, dtype=np.float32)
        shown[: self._own] = observation[: self._own]
        self._decider.begin()
        return self._decider.decide(shown)


def fixed_rule(settings: Settings) -> Rule:
    """The fixed layout of an environment's task: the first of its rules."""
    return rules_of(settings.task_name)[0]


def on_offer(settings: Settings) -> tuple[float, ...] | None:
    """[rad] axes that may be sent: those on offer, and the conveyor's; None: any there is."""
    if settings.action_kind.continuous:
        return None
    offered = within_right_angles(np.array(settings.chosen_orientations))
    return (*offered.tolist(), ROLLING)


@dataclass(frozen=True, eq=False)
class Bounds:
    """Between which each feature lies."""

    low: Observation
    high: Observation

    def hold(self, observation: Observation) -> bool:
        """Whether an observation is one that the environment may show."""
        return bool(((self.low <= observation) & (observation <= self.high)).all())


def bounds_of(settings: Settings) -> Bounds:
    """Those of an environment's observation."""
    low, high = np.array([(each.low, each.high) for each in settings.features], np.float32).T
    return Bounds(low, high)
