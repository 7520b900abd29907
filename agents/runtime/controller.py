"""Decisions: by the policy, and by the fixed layout, which replaces it while frames are missing.

Fixed layouts are arranged in a process of their own: some take tenths of a second of simulation.
"""

import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.layouts import ROLLING

from ..base import Controller
from ..rules import find_rules
from . import protocol
from .estimator import Resolver, StateEstimator, within_right_angles

Command = NDArray[Any]  # (size,) choices, or angles [rad]
Observation = NDArray[np.float32]  # (features,)
STOP_TIMEOUT = 5.0  # [s] that the process is given to end


class Decider:
    """A controller, asked about one parcel after the other."""

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
    """The fixed layout of a task, arranged for each parcel by its observation as it enters."""

    def __init__(self, config: EnvConfig) -> None:
        rule = find_rules(config.task_name)[0]  # the fixed layout comes first
        own = replace(config, actions=rule.actions, observe=(), observe_axes=False)
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


def allowed_angles(config: EnvConfig) -> tuple[float, ...] | None:
    """Return the axes [rad] that may be sent: those on offer, and the conveyor's; None: any."""
    if config.action_kind.continuous:
        return None
    offered = within_right_angles(np.array(config.chosen_orientations))
    return (*offered.tolist(), ROLLING)


class Arranger(Protocol):
    """Arranges a layout for each parcel."""

    def ask(self, observation: Observation) -> None:
        """Start to arrange the layout for a parcel that has entered; return at once."""

    def layout(self) -> Command | None:
        """Return the command for the latest parcel; None: it is not ready yet."""


class ProcessArranger:
    """Arranges layouts in a process of its own, which ends with this context."""

    def __init__(self, config: EnvConfig) -> None:
        context = get_context("spawn")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_arrange, args=(config, there), daemon=True)
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


def _arrange(config: EnvConfig, connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop ends this process
    layouts = FixedLayouts(config)
    connection.send(0)
    try:
        while True:
            asked, observation = connection.recv()
            while connection.poll():  # the latest is the one that counts
                asked, observation = connection.recv()
            connection.send((asked, layouts.arrange(observation)))
    except (EOFError, OSError):
        connection.close()


Between = Callable[[float], None]  # called after a period, with the time [s]
RIGHT_ANGLE = 0.5 * np.pi + 1e-9  # [rad] the greatest angle of an axis


class Clock(Protocol):
    """The clock of the loop: the machine's, or one of a test."""

    def now(self) -> float:
        """Return the time [s] since some moment; it never goes back."""

    def sleep_until(self, moment: float) -> None:
        """Wait until a time [s], if it has not passed."""


class WallClock:
    """The machine's clock, `time.monotonic()`."""

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, moment: float) -> None:
        left = moment - time.monotonic()
        if left > 0.0:
            time.sleep(left)


@dataclass
class Counts:
    """Numbers of events."""

    periods: int = 0  # control periods that were begun
    kept: int = 0  # of them done before the next was due
    missed: int = 0  # of them done later
    skipped: int = 0  # that were not begun, since one before them took so long
    decisions: int = 0  # by the policy
    by_fixed_layout: int = 0  # periods in which the fixed layout replaced the policy
    held: int = 0  # periods with a parcel in which the axes were left as they were
    unconnected: int = 0  # periods without a device
    sent: int = 0  # axis commands
    out_of_range: int = 0  # axis commands that were refused here, and not sent
    refused: int = 0  # axis commands that the device refused
    strayed: int = 0  # observations beyond their bounds
    frames: int = 0  # that arrived
    frames_unused: int = 0  # of them of another parcel, or out of order
    watchdog: int = 0  # times that frames stopped for too long
    connected: int = 0  # times that the device was found
    lost: int = 0  # times that it was lost
    attempts: int = 0  # to find it
    unfit: int = 0  # parcels that do not fit the surface or the task
    parcels: Counter[str] = field(default_factory=Counter)  # by outcome


@dataclass
class Latencies:
    """[s] of every decision that was sent."""

    late: list[float] = field(default_factory=list)  # from when a period is due to its beginning
    sensor: list[float] = field(default_factory=list)  # from the latest frame to the estimate
    filter: list[float] = field(default_factory=list)  # reading, estimating, observing
    policy: list[float] = field(default_factory=list)  # deciding
    send: list[float] = field(default_factory=list)  # from there until the axes began to turn
    turn: list[float] = field(default_factory=list)  # until the last axis has turned, as computed
    whole: list[float] = field(default_factory=list)  # from the latest frame until there
    work: list[float] = field(default_factory=list)  # of a period, from its beginning to its end


class AxisLimits:
    """The last check of axis commands: one that is not allowed is not changed, but not sent.

    Args:
        shape: (rows, columns) of the widest zone.
        allowed: [rad] angles that may be sent; None: any from -pi/2 to pi/2.
    """

    def __init__(self, shape: tuple[int, int], allowed: tuple[float, ...] | None) -> None:
        self._shape = shape
        self._allowed = None if allowed is None else np.array(allowed)

    def fault(self, angles: protocol.Angles) -> str:
        """Describe what is wrong with angles (rows, columns) [rad]; empty: they may be sent."""
        if angles.shape != self._shape:
            return f"axes must have the shape {self._shape}, got {angles.shape}"
        if not np.isfinite(angles).all():
            return "axes must be finite"
        if (np.abs(angles) > RIGHT_ANGLE).any():
            return f"axes must be between -pi/2 and pi/2, got {np.abs(angles).max():g} in them"
        if self._allowed is not None:
            apart = np.abs(angles[..., np.newaxis] - self._allowed).min(axis=-1)
            if apart.max() > 1e-9:
                worst = angles.ravel()[int(apart.argmax())]
                return f"axes must be some of those on offer, got {worst:g}"
        return ""


@dataclass
class _Sent:
    """A command that the device has not acknowledged yet."""

    command: int
    decided: float  # [s]
    before: float  # [s] from the latest frame until then
    turn: float  # [s] that the axes take


@dataclass(frozen=True)
class LoopConfig:
    """Times of the loop."""

    period: float = 0.04  # [s] between decisions
    watchdog: float = 0.2  # [s] without a frame after which the fixed layout replaces the policy
    first_wait: float = 0.1  # [s] from a device's loss to the second attempt to find it
    longest_wait: float = 1.0  # [s] to which it doubles from attempt to attempt

    def __post_init__(self) -> None:
        for name in ("period", "watchdog", "first_wait", "longest_wait"):
            checks.positive(name, getattr(self, name))


class ControlLoop:
    """Runs a policy on a device."""

    def __init__(
        self,
        device: protocol.Device,
        estimator: StateEstimator,
        policy: Decider,
        fixed: tuple[Arranger, Resolver],
        limits: AxisLimits,
        bounds: spaces.Box,
        clock: Clock,
        config: LoopConfig,
    ) -> None:
        self._device, self._estimator, self._policy = device, estimator, policy
        self._arranger, self._by_fixed = fixed
        self._by_policy = estimator.resolver(policy.kind)
        self._limits, self._bounds, self._clock, self._config = limits, bounds, clock, config
        self.counts, self.latencies = Counts(), Latencies()
        self._connected = False
        self._next_attempt = -1e9
        self._wait = config.first_wait
        self._latest_arrival = 0.0  # [s] of a frame
        self._latest_frame = 0.0  # [s] when it was taken
        self._stopped = False  # frames have, for too long
        self._sent: list[_Sent] = []

    def run(self, seconds: float, between: Between) -> None:
        """Run for some time [s], or until a KeyboardInterrupt; `between` is called each period."""
        period = self._config.period
        begun = self._clock.now() + period
        number, last = 0, round(seconds / period)
        try:
            while number < last:
                due = begun + number * period
                self._clock.sleep_until(due)
                self.step(due)
                between(self._clock.now())
                # Periods that are gone as a whole are not begun.
                number += 1
                gone = int((self._clock.now() - begun) / period)
                if gone > number:
                    self.counts.skipped += min(gone, last) - number
                    number = gone
        finally:
            self._device.close()

    def step(self, due: float) -> None:
        """Carry out one period, due at a time [s]."""
        woke = self._clock.now()
        counts = self.counts
        counts.periods += 1
        try:
            if self._connect(woke):
                for message in self._device.read():
                    self._handle(message)
                if self._estimator.entered is not None:
                    self._control(woke, due)
            else:
                counts.unconnected += 1
        except protocol.DeviceLost:
            self._lose()
        done = self._clock.now()
        self.latencies.work.append(done - woke)
        if done <= due + self._config.period:
            counts.kept += 1
        else:
            counts.missed += 1

    @property
    def has_parcel(self) -> bool:
        return self._estimator.entered is not None

    def _connect(self, now: float) -> bool:
        """Connect the device if need be, and tell whether it is connected."""
        if self._connected:
            return True
        if now < self._next_attempt:
            return False
        self.counts.attempts += 1
        try:
            self._device.connect()
        except protocol.DeviceLost:
            self._next_attempt = now + self._wait
            self._wait = min(2.0 * self._wait, self._config.longest_wait)
            return False
        self._connected = True
        self.counts.connected += 1
        return True

    def _lose(self) -> None:
        """Give up the connection, and with it the parcel."""
        self._device.close()
        if self._connected:
            self.counts.lost += 1
        self._connected = False
        self._next_attempt = self._clock.now() + self._wait
        self._wait = min(2.0 * self._wait, self._config.longest_wait)
        self._estimator.clear()
        self._sent.clear()

    def _handle(self, message: protocol.Message) -> None:
        self._wait = self._config.first_wait
        if isinstance(message, protocol.Frame):
            self._correct(message)
        elif isinstance(message, protocol.Entered):
            self._enter(message)
        elif isinstance(message, protocol.AxesAcknowledged):
            self._acknowledge(message)
        elif isinstance(message, protocol.Departed):
            self.counts.parcels[message.outcome] += 1
            self._estimator.clear()
            self._sent.clear()

    def _correct(self, frame: protocol.Frame) -> None:
        self.counts.frames += 1
        self._latest_arrival = self._clock.now()
        if frame.number is None:
            return
        try:
            used = self._estimator.correct(frame)
        except ValueError as error:  # a driver that sends such a pose cannot be trusted
            raise protocol.DeviceLost(str(error)) from None
        if used:
            self._latest_frame = frame.taken_at
        else:
            self.counts.frames_unused += 1

    def _enter(self, entered: protocol.Entered) -> None:
        try:
            self._estimator.reset(entered)
        except ValueError:
            self.counts.unfit += 1
            self._estimator.clear()
            return
        self._sent.clear()
        self._latest_arrival = self._clock.now()
        self._latest_frame = entered.at
        self._stopped = False
        self._policy.reset()
        self._arranger.ask(self._estimator.observe(entered.at))

    def _acknowledge(self, answer: protocol.AxesAcknowledged) -> None:
        if answer.refused:
            self.counts.refused += 1
            self._estimator.drop_command(answer.command)
        else:
            self._estimator.acknowledge(answer.command, answer.at)
        for sent in self._sent:
            if sent.command == answer.command and not answer.refused:
                send = max(0.0, answer.at - sent.decided)
                self.latencies.send.append(send)
                self.latencies.whole.append(sent.before + send + sent.turn)
        self._sent = [sent for sent in self._sent if sent.command > answer.command]

    def _control(self, woke: float, due: float) -> None:
        """Estimate, decide and send for the parcel on the surface."""
        counts = self.counts
        observation = self._estimator.observe(self._clock.now())
        observed = self._clock.now()
        stopped = observed - self._latest_arrival > self._config.watchdog
        counts.watchdog += stopped and not self._stopped
        self._stopped = stopped
        within = self._bounds.contains(observation)
        counts.strayed += not within
        command, resolver = self._command(observation, within and not stopped)
        if command is None:
            counts.held += 1
            return
        angles = self._estimator.resolve(resolver, command)
        if self._limits.fault(angles):
            counts.out_of_range += 1
            counts.held += 1
            return
        turn = self._estimator.longest_turn(angles)
        decided = self._clock.now()
        number = self._device.set_axes(angles)
        self._estimator.note_sent(number, self._clock.now())
        counts.sent += 1
        if resolver is self._by_fixed:
            counts.by_fixed_layout += 1
            return
        counts.decisions += 1
        latencies = self.latencies
        latencies.late.append(woke - due)
        latencies.sensor.append(observed - self._latest_frame)
        latencies.filter.append(observed - woke)
        latencies.policy.append(decided - observed)
        latencies.turn.append(turn)
        self._sent.append(_Sent(number, decided, decided - self._latest_frame, turn))

    def _command(self, observation: Observation, trusted: bool) -> tuple[Command | None, Resolver]:
        """Return the command and its resolver; None: leave the axes as they are."""
        if not trusted:
            return self._arranger.layout(), self._by_fixed
        try:
            return self._policy.decide(observation), self._by_policy
        except ValueError:  # the policy returned no action
            self.counts.out_of_range += 1
            return None, self._by_policy
