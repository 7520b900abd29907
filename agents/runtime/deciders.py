"""Deciders of the control loop: a policy, fixed layouts, or motions that identify a surface.

Fixed layouts are computed in a separate process, because some take tenths of a second.
"""

import signal
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.layouts import ROLLING
from surface_gym.machine.log import excitation

from ..base import Controller, Singles
from ..rules import find_rules
from .estimator import within_right_angles

Command = NDArray[Any]  # (size,) choices, or angles [rad]
Observation = NDArray[np.float32]  # (features,)
STOP_TIMEOUT = 5.0  # [s] maximum time for the process to end


class Decider:
    """A controller and the controller's state; `reset` clears the state before the next parcel."""

    def __init__(self, controller: Controller, config: EnvConfig) -> None:
        self._controller = controller
        self.kind = config.action_kind
        self._state: Any = None
        self._is_first = True

    def reset(self) -> None:
        self._state, self._is_first = None, True

    def decide(self, observation: Observation) -> Command:
        action, self._state = self._controller.predict(
            observation[np.newaxis],
            self._state,
            episode_start=np.array([self._is_first]),
            deterministic=True,
        )
        self._is_first = False
        return self.kind.commands(action, 1)[0]


class FixedLayouts:
    """Fixed layouts of a task: a parcel's first observation determines the parcel's layout."""

    def __init__(self, config: EnvConfig) -> None:
        rule = find_rules(config.task_name)[0]  # the fixed layout is first
        own = replace(config, actions=rule.actions, observe=(), observe_axes=False)
        self._decider = Decider(rule.make(own), own)
        self._own = len(own.task.features)
        self._features = len(own.features)
        self.kind = self._decider.kind

    def arrange(self, observation: Observation) -> Command | None:
        """Return a new parcel's command, or None if the observation is invalid.

        The layout depends only on the task's features, the first entries of the observation.
        """
        shown = np.zeros(self._features, dtype=np.float32)
        shown[: self._own] = observation[: self._own]
        self._decider.reset()
        try:
            return self._decider.decide(shown)
        except ValueError:
            return None


def allowed_angles(config: EnvConfig) -> tuple[float, ...] | None:
    """Return the allowed axis angles [rad], the orientations and 90 deg. None means all angles."""
    if config.action_kind.continuous:
        return None
    offered = within_right_angles(np.array(config.chosen_orientations))
    return (*offered.tolist(), ROLLING)


class Arranger(Protocol):
    """Computes a layout for each parcel."""

    def ask(self, observation: Observation) -> None:
        """Start to compute the layout for a parcel that has just entered; return at once."""

    def layout(self) -> Command | None:
        """Return the command for the latest parcel, or None while the command is not ready."""


class ProcessArranger:
    """Computes layouts in a separate process, which ends when the `with` block ends."""

    def __init__(self, config: EnvConfig) -> None:
        context = get_context("spawn")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_arrange, args=(config, there), daemon=True)
        self._process.start()
        there.close()
        self._asked = 0
        self._is_busy = False  # at most one request at a time, so that sending never waits
        self._next: Observation | None = None
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
        """Wait at most `timeout` [s] for the process; return whether it is ready."""
        return self._here.poll(timeout) and self._here.recv() == 0

    def ask(self, observation: Observation) -> None:
        self._asked += 1
        self._layout, self._next = None, observation
        self.layout()

    def layout(self) -> Command | None:
        """Return the command for the latest parcel, or None while no command is ready."""
        try:
            while self._here.poll():
                asked, layout = self._here.recv()
                self._is_busy = False
                if asked == self._asked:
                    self._layout = layout
            if self._next is not None and not self._is_busy:
                self._here.send((self._asked, self._next))
                self._next, self._is_busy = None, True
        except (EOFError, OSError):  # the process has ended: hold the axes
            self._next = None
        return self._layout


def _arrange(config: EnvConfig, connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # only the loop ends this process
    layouts = FixedLayouts(config)
    connection.send(0)
    try:
        while True:
            asked, observation = connection.recv()
            connection.send((asked, layouts.arrange(observation)))
    except (EOFError, OSError):
        connection.close()


class SafeAxes:
    """An `Arranger` that sets all axes to the same angle."""

    def __init__(self, angle: float) -> None:
        self._layout = np.array([angle])

    def ask(self, observation: Observation) -> None:
        """Do nothing, because the angle does not depend on parcels."""

    def layout(self) -> Command:
        return self._layout


class ExcitationController:
    """A `Controller` that moves all axes so that a surface can be identified; see `excitation`.

    `config` is the configuration of an environment with a choice for each module.
    """

    def __init__(self, config: EnvConfig) -> None:
        kind = config.action_kind
        self._shape = (kind.rows, kind.columns)
        self._period = config.control_period
        self._seconds = config.task.periods * config.control_period
        self._offered = np.array(config.chosen_orientations)  # [rad]
        self._runs = -1
        self._axes = np.zeros((0, *self._shape))

    def predict(
        self,
        observation: Singles,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Return the action of the next control period; the observation has no effect."""
        del episode_start, deterministic
        if state is None:
            self._runs += 1
            self._axes = excitation(self._shape, self._seconds, run=self._runs, period=self._period)
            state = 0  # control periods since the parcel entered
        axes = self._axes[min(state, len(self._axes) - 1)].ravel()
        apart = np.abs(np.sin(axes[:, np.newaxis] - self._offered))  # axes have period pi
        choices = np.tile(apart.argmin(axis=1), (len(observation), 1))
        return choices, state + 1
