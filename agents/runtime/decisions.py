"""Decisions: by the policy, and by the fixed layout, which replaces it while frames are missing.

Fixed layouts are arranged in a process of their own: some take tenths of a second of simulation.
"""

import signal
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.layouts import ROLLING

from ..base import Controller
from ..rules import find_rules
from .estimator import within_right_angles

Command = NDArray[Any]  # (size,) choices, or angles [rad]
Observation = NDArray[np.float32]  # (features,)
STOP_TIMEOUT = 5.0  # [s] that the process is given to end


class Decider:
    """A controller, asked about one parcel after the other.

    Args:
        controller: that decides.
        settings: of the environment that it is for.
    """

    def __init__(self, controller: Controller, settings: EnvConfig) -> None:
        self._controller = controller
        self.kind = settings.action_kind
        self._state: Any = None
        self._is_first = True

    def reset(self) -> None:
        """Start with a parcel that has just entered."""
        self._state, self._is_first = None, True

    def decide(self, observation: Observation) -> Command:
        """Return the command for an observation.

        Raises:
            ValueError: the controller returned no action of its environment.
        """
        action, self._state = self._controller.predict(
            observation[np.newaxis],
            self._state,
            episode_start=np.array([self._is_first]),
            deterministic=True,
        )
        self._is_first = False
        command: Command = self.kind.commands(action, 1)[0]
        return command


class FixedLayouts:
    """The fixed layout of a task, arranged for each parcel by its observation as it enters.

    Args:
        settings: of the policy's environment.
    """

    def __init__(self, settings: EnvConfig) -> None:
        rule = find_rules(settings.task_name)[0]  # the fixed layout comes first
        own = replace(settings, actions=rule.actions, observe=(), observe_axes=False)
        self._decider = Decider(rule.make(own), own)
        self._own = len(own.task.features)
        self._features = len(own.features)
        self.kind = self._decider.kind

    def arrange(self, observation: Observation) -> Command:
        """Return the command for a parcel that has just entered, by the policy's observation.

        Only the task's own features count, which come first in every observation.
        """
        shown = np.zeros(self._features, dtype=np.float32)
        shown[: self._own] = observation[: self._own]
        self._decider.reset()
        return self._decider.decide(shown)


def allowed_angles(settings: EnvConfig) -> tuple[float, ...] | None:
    """Return the axes [rad] that may be sent: those on offer, and the conveyor's; None: any."""
    if settings.action_kind.continuous:
        return None
    offered = within_right_angles(np.array(settings.chosen_orientations))
    return (*offered.tolist(), ROLLING)


@dataclass(frozen=True, eq=False)
class Bounds:
    """Least and greatest values of the features."""

    low: Observation
    high: Observation

    def contain(self, observation: Observation) -> bool:
        """Tell whether an observation lies within."""
        return bool(((self.low <= observation) & (observation <= self.high)).all())


def observation_bounds(settings: EnvConfig) -> Bounds:
    """Return the bounds of an environment's observation."""
    low, high = np.array([(each.low, each.high) for each in settings.features], np.float32).T
    return Bounds(low, high)


class Arranger(Protocol):
    """Arranges a layout for each parcel."""

    def ask(self, observation: Observation) -> None:
        """Start to arrange the layout for a parcel that has entered; return at once."""

    def layout(self) -> Command | None:
        """Return the command for the latest parcel; None: it is not ready yet."""


class LocalArranger:
    """Arranges layouts at once, in this process."""

    def __init__(self, layouts: FixedLayouts) -> None:
        self._layouts = layouts
        self._layout: Command | None = None

    def ask(self, observation: Observation) -> None:
        """Arrange the layout."""
        self._layout = self._layouts.arrange(observation)

    def layout(self) -> Command | None:
        """Return the command."""
        return self._layout


class ProcessArranger:
    """Arranges layouts in a process of its own, which ends with this context.

    Args:
        settings: of the policy's environment.
    """

    def __init__(self, settings: EnvConfig) -> None:
        context = get_context("spawn")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_arrange, args=(settings, there), daemon=True)
        self._process.start()
        there.close()
        self._asked = 0
        self._layout: Command | None = None

    def __enter__(self) -> "ProcessArranger":
        return self

    def __exit__(self, *_: object) -> None:
        self._here.close()
        self._process.join(STOP_TIMEOUT)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def wait_until_ready(self, timeout: float) -> bool:
        """Wait for the process for a time [s] at most, and tell whether it is ready."""
        return self._here.poll(timeout) and self._here.recv() == 0

    def ask(self, observation: Observation) -> None:
        """Send the observation to the process."""
        self._asked += 1
        self._layout = None
        self._here.send((self._asked, observation))

    def layout(self) -> Command | None:
        """Return the command; None: it is not ready yet."""
        while self._here.poll():
            asked, layout = self._here.recv()
            if asked == self._asked:
                self._layout = layout
        return self._layout


def _arrange(settings: EnvConfig, connection: Connection) -> None:
    """Arrange layouts until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop ends this process
    layouts = FixedLayouts(settings)
    connection.send(0)
    try:
        while True:
            asked, observation = connection.recv()
            while connection.poll():  # the latest is the one that counts
                asked, observation = connection.recv()
            connection.send((asked, layouts.arrange(observation)))
    except (EOFError, OSError):
        connection.close()
