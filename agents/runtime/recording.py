"""A device whose messages are logged, and a controller that excites a surface for the log."""

from collections.abc import Callable
from typing import Any

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.lines import Site
from surface_gym.machine.log import LogWriter, excitation
from surface_gym.parcel import Parcel

from ..base import Singles
from .protocol import Angles, Device, Message, ParcelEntry, axes_to_fields, to_fields


class LoggedDevice:
    """A `Device` that writes all messages of another device to a log.

    Args:
        device: the other device.
        log: where to write; its owner closes it.
        site_of: returns the rotors and the zone for a parcel.
        now: clock [s] of the messages.
    """

    def __init__(
        self,
        device: Device,
        log: LogWriter,
        site_of: Callable[[Parcel], Site],
        now: Callable[[], float],
    ) -> None:
        self._device, self._log, self._site_of, self._now = device, log, site_of, now

    def connect(self) -> None:
        self._device.connect()

    def close(self) -> None:
        self._device.close()

    def read(self) -> list[Message]:
        messages, passed = self._device.read(), self._now()
        for message in messages:
            if isinstance(message, ParcelEntry):
                self._log.write_site(passed, self._site_of(message.parcel))
            self._log.write(passed, "in", to_fields(message))
        return messages

    def set_axes(self, angles: Angles) -> int:
        number = self._device.set_axes(angles)
        self._log.write(self._now(), "out", axes_to_fields(number, angles))
        return number


class ExcitationController:
    """A `Controller` of one environment: `excitation` for each parcel in turn.

    Args:
        config: an environment with a choice for each module.
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
