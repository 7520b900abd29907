"""The control loop of a stream: many parcels at once, and a gate."""

from collections import deque

import numpy as np
from gymnasium import spaces

from surface_gym.flow.base import MOST_PARCELS
from surface_gym.layouts import ROLLING

from . import protocol
from .controller import (
    AxisLimits,
    Clock,
    Command,
    ControlLoop,
    Decider,
    LoopConfig,
    Observation,
    faults_of_device,
)
from .protocol import MAX_LATE
from .report import count_name
from .tracker import StreamTracker

BRAKING = 0.0  # [rad] axis of a module that brakes a parcel along x


class SafeAxes:
    """An `Arranger` of one angle for all axes."""

    def __init__(self, angle: float) -> None:
        self._layout = np.array([angle])

    def ask(self, observation: Observation) -> None:
        """The angle does not depend on parcels."""

    def layout(self) -> Command:
        return self._layout


class StreamLoop(ControlLoop):
    """Runs a policy of a stream on a device.

    While pictures are missing, the gate stays shut. All axes brake if the task has a take-away;
    otherwise all parcels roll on to the end.
    """

    pictures = protocol.Detections

    def __init__(
        self,
        device: protocol.GatedDevice,
        tracker: StreamTracker,
        policy: Decider,
        limits: AxisLimits,
        bounds: spaces.Box,
        clock: Clock,
        config: LoopConfig,
    ) -> None:
        task = tracker.config.stream_task
        safe = SafeAxes(BRAKING if task.takes_away else ROLLING)
        super().__init__(device, tracker, policy, (safe, None), limits, bounds, clock, config)
        self._gated_device, self._tracker = device, tracker
        self._dt = tracker.config.timing.dt if task.gate else 0.0  # [s] a step; 0: no gate
        self._open = deque(maxlen=2 * MOST_PARCELS)

    @property
    def has_parcel(self) -> bool:
        """Return False: a stream has no pauses, so that others wait for the end of a period."""
        return False

    def _enter(self, entered: protocol.ParcelEntry) -> None:
        try:
            if not entered.waits and not self._is_timely(entered.at):
                raise ValueError(f"at must be within {MAX_LATE:g} s of now, got another time")
            self._tracker.enter(entered)
        except ValueError as error:
            self.counts.unfit += 1
            count_name(self.counts.faults, str(error))
            return
        if entered.number not in self._open:
            self._open.append(entered.number)

    def _lose(self, fault: str) -> None:
        super()._lose(fault)
        self._policy.reset()

    def _decide(self, observation: Observation) -> Command | None:
        command = super()._decide(observation)
        if self._dt > 0.0 and command is not None and command[-1] > 0:
            now = self._clock.now()
            begin = now + self._dt * float(command[-1])
            with faults_of_device():
                self._gated_device.open_gate(begin, now + self._config.period)
        return command
