"""The control loop: the policy decides; if the camera's frames stop, a fixed layout takes over."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.base import MOST_PARCELS
from surface_gym.layouts import ROLLING
from surface_gym.machine import messages as ms

from ..base import Controller
from . import protocol
from .deciders import Arranger, Command, Decider, Observation, SafeAxes, allowed_angles
from .estimator import MAX_COMMANDS, Estimator, Resolver, StateEstimator
from .report import Counts, Latencies, count_name

if TYPE_CHECKING:
    from .tracker import StreamTracker

MAX_MESSAGES = 1000  # maximum messages of a device per period
READING = 0.5  # [-] share of a period for reading; later messages wait for the next period
MAX_QUIET = 2.0  # [s] maximum time without a message of a device that acknowledges commands
MAX_OPEN = 16  # maximum number of parcels on the surface
BRAKING = 0.0  # [rad] axis of a module that brakes a parcel along x

Between = Callable[[float], None]  # callback after a period, with the time [s]


@dataclass
class _SentCommand:
    """A command that the device has not acknowledged yet."""

    command: int
    decided: float  # [s] time of the decision
    before: float  # [s] from the latest frame to the decision
    turn: float  # [s] turning time of the axes


@dataclass(frozen=True)
class LoopConfig:
    """Timing of the loop."""

    period: float = 0.04  # [s] between decisions
    # [s] maximum time without a frame or an expected acknowledgement; then the fixed layout
    # replaces the policy
    watchdog: float = 0.2
    first_wait: float = 0.1  # [s] from the loss of a device to the second attempt to connect
    longest_wait: float = 1.0  # [s] maximum wait; waits double with every attempt

    def __post_init__(self) -> None:
        for name in ("period", "watchdog", "first_wait", "longest_wait"):
            checks.positive(name, getattr(self, name))


class ControlLoop:
    """Runs a policy on a device.

    Args:
        estimator: estimator of the machine's parcels.
        fixed: `Arranger` and `Resolver` of fixed layouts. If frames stop, fixed layouts replace
            the policy.
        controller: the policy.
        env_config: configuration of the policy's environment.
        listeners: objects that receive all messages and commands.
    """

    pictures: type[ms.Frame | ms.Detections] = ms.Frame  # others are not used

    def __init__(
        self,
        device: protocol.Device,
        estimator: Estimator,
        fixed: tuple[Arranger, Resolver | None],
        controller: Controller,
        env_config: EnvConfig,
        clock: protocol.Clock,
        config: LoopConfig,
        listeners: Sequence[protocol.Listener] = (),
    ) -> None:
        self._device, self._estimator, self._listeners = device, estimator, listeners
        self._policy = Decider(controller, env_config)
        self._arranger, self._by_fixed = fixed
        self._by_policy = estimator.resolver(self._policy.kind)
        self._limits = protocol.AxisLimits(estimator.shape, allowed_angles(env_config))
        self._bounds = env_config.observation_space()
        self._clock, self._config = clock, config
        self.counts, self.latencies = Counts(), Latencies()
        self._connected = False
        self._next_attempt = -1e9
        self._wait = config.first_wait
        self._latest_arrival = 0.0  # [s] arrival of the latest frame
        self._latest_frame = 0.0  # [s] time at which it was taken
        self._stopped = False  # whether frames have stopped for too long
        self._acknowledges = False  # whether the device has acknowledged a command
        self._unanswered = False  # whether acknowledgements have stopped for too long
        self._quiet = 0  # periods of control since the latest message
        self._sent: deque[_SentCommand] = deque(maxlen=MAX_COMMANDS)
        self._inbox: deque[ms.Message] = deque()  # unhandled messages
        self._open: deque[int] = deque(maxlen=MAX_OPEN)  # parcels on the surface

    def warm_up(self) -> None:
        """Decide once before the run, because the first decision is slow."""
        bounds = self._bounds
        self._policy.decide(np.zeros_like(bounds.low).clip(bounds.low, bounds.high))
        self._policy.reset()

    def run(self, seconds: float, between: Between) -> None:
        """Run for `seconds` [s] or until KeyboardInterrupt. Call `between` after each period."""
        period = self._config.period
        begun = self._clock.now() + period
        number, last = 0, round(seconds / period)
        try:
            while number < last:
                ahead = begun + number * period - self._clock.now()
                if ahead > 2.0 * period:
                    self._set_back(ahead - period)
                    begun -= ahead - period
                due = begun + number * period
                self._clock.sleep_until(due)
                self.step(due)
                between(self._clock.now())
                # Skip periods that have passed completely.
                number += 1
                gone = int((self._clock.now() - begun) / period)
                if gone > number:
                    self.counts.skipped += min(gone, last) - number
                    number = gone
        finally:
            self._device.close()

    def _set_back(self, by: float) -> None:
        """Correct stored times after the clock was set back; `by` [s] is the difference."""
        self.counts.set_back += 1
        self._latest_arrival -= by
        self._next_attempt -= by
        self._sent.clear()

    def step(self, due: float) -> None:
        """Execute the control period that is due at a time [s]."""
        woke = self._clock.now()
        counts = self.counts
        counts.periods += 1
        try:
            if self._connect(woke):
                self._read(woke + READING * self._config.period)
                if self._estimator.entered is not None:
                    self._control(woke, due)
            else:
                counts.unconnected += 1
                self._hear(())
        except protocol.DeviceLost as error:
            self._lose(str(error))
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
        """Connect the device if the next attempt is due. Return whether a connection exists."""
        if self._connected:
            return True
        if now < self._next_attempt:
            return False
        self.counts.attempts += 1
        try:
            with faults_of_device():
                self._device.connect()
        except protocol.DeviceLost:
            self._next_attempt = now + self._wait
            self._wait = min(2.0 * self._wait, self._config.longest_wait)
            return False
        self._connected, self._quiet = True, 0
        self.counts.connected += 1
        return True

    def _lose(self, fault: str) -> None:
        """Close the connection, count the `fault`, and forget the parcel."""
        self._device.close()
        count_name(self.counts.faults, fault)
        if self._connected:
            self.counts.lost += 1
        self._connected = False
        self._next_attempt = self._clock.now() + self._wait
        self._wait = min(2.0 * self._wait, self._config.longest_wait)
        self._estimator.clear()
        self._sent.clear()
        self._inbox.clear()

    def _read(self, until: float) -> None:
        """Handle messages until the time `until` [s]. Unhandled messages stay in the queue."""
        if not self._inbox:
            with faults_of_device():
                self._inbox.extend(self._device.read())
            self._hear(self._inbox)
            if len(self._inbox) > MAX_MESSAGES:
                raise protocol.DeviceLost(
                    f"device must give at most {MAX_MESSAGES} messages a period, "
                    f"got {len(self._inbox)}"
                )
        while self._inbox and self._clock.now() <= until:
            self._handle(self._inbox.popleft())

    def _hear(self, messages: Sequence[ms.Message]) -> None:
        with faults_of_device():
            for each in self._listeners:
                each.hear(messages, self.counts, self.latencies)

    def _handle(self, message: ms.Message) -> None:
        with faults_of_device():
            ms.check_message(message, self._estimator.shape)
        self._wait, self._quiet = self._config.first_wait, 0
        if isinstance(message, (ms.Frame, ms.Detections)):
            self._correct(message)
        elif isinstance(message, ms.ParcelEntry):
            self._enter(message)
        elif isinstance(message, ms.AxesAcknowledgement):
            self._acknowledge(message)
        elif isinstance(message, ms.ParcelDeparture):
            self._depart(message)

    def _is_timely(self, moment: float) -> bool:
        """Return whether a message's time [s] is near enough to the present for the estimator."""
        return -ms.MAX_EARLY <= self._clock.now() - moment <= ms.MAX_LATE

    def _correct(self, frame: ms.Frame | ms.Detections) -> None:
        if not isinstance(frame, self.pictures):
            self.counts.unused += 1
            return
        self.counts.frames += 1
        if isinstance(frame, ms.Frame) and frame.number is None:
            return
        if self._is_timely(frame.taken_at) and self._estimator.correct(frame):
            self._latest_arrival = self._clock.now()
            self._latest_frame = frame.taken_at
        else:
            self.counts.frames_unused += 1

    def _enter(self, entered: ms.ParcelEntry) -> None:
        assert isinstance(self._estimator, StateEstimator)
        before = self._estimator.entered
        if before is not None and _describe(entered) == _describe(before):
            self.counts.unused += 1
            count_name(self.counts.faults, "number must be a new one of each parcel, got it twice")
            return
        if entered.number in self._open:  # numbers began again
            self._open.remove(entered.number)
        self._open.append(entered.number)
        try:
            if not self._is_timely(entered.at):
                raise ValueError(f"at must be within {ms.MAX_LATE:g} s of now, got another time")
            self._estimator.reset(entered)
        except ValueError as error:
            self.counts.unfit += 1
            count_name(self.counts.faults, str(error))
            self._estimator.clear()
            return
        self._sent.clear()
        self._latest_arrival = self._clock.now()
        self._latest_frame = entered.at
        self._stopped = self._unanswered = False
        self._policy.reset()
        self._arranger.ask(self._estimator.observe(entered.at))

    def _depart(self, departed: ms.ParcelDeparture) -> None:
        if departed.number not in self._open:
            self.counts.unused += 1
            return
        self._open.remove(departed.number)
        count_name(self.counts.parcels, departed.outcome)
        if self._estimator.depart(departed.number):
            self._sent.clear()

    def _acknowledge(self, answer: ms.AxesAcknowledgement) -> None:
        if answer.refused:
            self.counts.refused += 1
            self._estimator.drop_command(answer.command)
        elif not self._is_timely(answer.at):
            self.counts.unused += 1
            return
        else:
            self._estimator.acknowledge(answer.command, answer.at)
        for sent in self._sent:
            if sent.command == answer.command:
                self._acknowledges = True
                if not answer.refused:
                    send = max(0.0, answer.at - sent.decided)
                    self.latencies.send.append(send)
                    self.latencies.whole.append(sent.before + send + sent.turn)
        while self._sent and self._sent[0].command <= answer.command:
            self._sent.popleft()

    def _control(self, woke: float, due: float) -> None:
        """Estimate the parcel's state, choose a command, and send the command.

        The period was due at the time `due` [s]; the loop woke up at the time `woke` [s].
        """
        counts = self.counts
        self._watch()
        observation = self._estimator.observe(self._clock.now())
        observed = self._clock.now()
        within = self._bounds.contains(observation)
        counts.strayed += not within
        command, resolver = self._arranger.layout(), self._by_fixed
        if within and not (self._stopped or self._unanswered):
            command, resolver = self._decide(observation), self._by_policy
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
        with faults_of_device():
            number = self._device.set_axes(angles)
            checks.integer("command", number, least=0)
            for each in self._listeners:
                each.hear_command(number, angles)
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
        if self._sent and number <= self._sent[-1].command:  # numbers began again
            self._sent.clear()
        self._sent.append(_SentCommand(number, decided, decided - self._latest_frame, turn))

    def _watch(self) -> None:
        """Check whether frames or acknowledgements have stopped.

        Raises:
            DeviceLost: no message came for `MAX_QUIET`.
        """
        self._quiet += 1
        if self._acknowledges and self._quiet * self._config.period > MAX_QUIET:
            raise protocol.DeviceLost(
                f"device must send a message within {MAX_QUIET:g} s of a command, got none"
            )
        latest = self._clock.now() - self._config.watchdog
        stopped = self._latest_arrival < latest
        waits = self._acknowledges and bool(self._sent) and self._sent[0].decided < latest
        self.counts.watchdog += stopped and not self._stopped
        self.counts.unacknowledged += waits and not self._unanswered
        self._stopped, self._unanswered = stopped, waits

    def _decide(self, observation: Observation) -> Command | None:
        """Return the policy's command. For an invalid action, return None, and no axis turns."""
        try:
            return self._policy.decide(observation)
        except ValueError:  # the policy returned no valid action
            self.counts.out_of_range += 1
            return None


class StreamLoop(ControlLoop):
    """Runs a policy of a stream on a device.

    While pictures are missing, the gate stays shut, and a fixed layout replaces the policy. If the
    task has a take-away conveyor, all axes of this layout brake parcels. In other tasks, all axes
    let parcels roll on to the end.
    """

    pictures = ms.Detections

    def __init__(
        self,
        device: protocol.GatedDevice,
        tracker: "StreamTracker",
        controller: Controller,
        env_config: EnvConfig,
        clock: protocol.Clock,
        config: LoopConfig,
        listeners: Sequence[protocol.Listener] = (),
    ) -> None:
        task = tracker.config.stream_task
        safe = SafeAxes(BRAKING if task.takes_away else ROLLING)
        given = (controller, env_config, clock, config, listeners)
        super().__init__(device, tracker, (safe, None), *given)
        self._gated_device, self._tracker = device, tracker
        self._dt = tracker.config.timing.dt if task.gate else 0.0  # [s] a step; 0: no gate
        self._open = deque(maxlen=2 * MOST_PARCELS)

    @property
    def has_parcel(self) -> bool:
        """Return False, so that the display of progress never waits. A stream has no pauses."""
        return False

    def _correct(self, frame: ms.Frame | ms.Detections) -> None:
        before = self.counts.frames_unused
        super()._correct(frame)
        if isinstance(frame, ms.Detections) and self.counts.frames_unused == before:
            with faults_of_device():  # as where others hear
                for each in self._listeners:
                    each.hear_tracked(frame.taken_at, self._tracker.tracked)

    def _enter(self, entered: ms.ParcelEntry) -> None:
        try:
            if not entered.waits and not self._is_timely(entered.at):
                raise ValueError(f"at must be within {ms.MAX_LATE:g} s of now, got another time")
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


@contextmanager
def faults_of_device() -> Iterator[None]:
    """Turn a driver's error, or an error about a driver's values, into a `DeviceLost` error."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise protocol.DeviceLost(str(error)) from None


def _describe(entered: ms.ParcelEntry) -> dict[str, Any]:
    """Return the entry's fields whose values are equal in all messages about one parcel."""
    fields = ms.to_fields(entered)
    return {name: fields[name] for name in ("number", "base", "mass", "com_height", "goal", "path")}
