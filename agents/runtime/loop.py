"""The control loop: each period reads, estimates, decides and sends, and is counted."""

from collections.abc import Callable
from dataclasses import dataclass

from surface_gym import checks

from .arranging import Arranger
from .axis_guard import AxisGuard
from .clock import Clock
from .counting import Counts, Latencies
from .deciding import Bounds, Command, Decider, Observation
from .device import AxesTaken, Device, DeviceLost, Entered, Frame, Left, Message
from .shadow import Shadow
from .told import Resolver, Sent

Between = Callable[[float], None]  # what is done after a period, at a time [s]


@dataclass(frozen=True)
class LoopConfig:
    """How the loop keeps time.

    Raises:
        ValueError: a number that is not positive.
    """

    period: float = 0.04  # [s] between decisions
    watchdog: float = 0.2  # [s] without a frame after which the fixed layout stands in
    first_wait: float = 0.1  # [s] from a device's loss to the second attempt to find it
    longest_wait: float = 1.0  # [s] to which it doubles from attempt to attempt

    def __post_init__(self) -> None:
        for name in ("period", "watchdog", "first_wait", "longest_wait"):
            checks.positive(name, getattr(self, name))


class Loop:
    """Runs a policy on a device.

    Args:
        device: the machine; the loop connects and closes it.
        shadow: what is held for true.
        policy: decides.
        fixed: arranges the layout that stands in, and how its commands are meant.
        guard: the last look at what is sent.
        bounds: of observations.
        clock: by which it lives, that of the device's times.
        config: how it keeps time.
    """

    def __init__(
        self,
        device: Device,
        shadow: Shadow,
        policy: Decider,
        fixed: tuple[Arranger, Resolver],
        guard: AxisGuard,
        bounds: Bounds,
        clock: Clock,
        config: LoopConfig,
    ) -> None:
        self._device, self._shadow, self._policy = device, shadow, policy
        self._arranger, self._by_fixed = fixed
        self._by_policy = shadow.resolver(policy.kind)
        self._guard, self._bounds, self._clock, self._config = guard, bounds, clock, config
        self.counts, self.latencies = Counts(), Latencies()
        self._connected = False
        self._next_attempt = -1e9
        self._wait = config.first_wait
        self._latest_arrival = 0.0  # [s] of a frame
        self._latest_frame = 0.0  # [s] when it was taken
        self._stopped = False  # frames have, for too long
        self._sent: list[Sent] = []

    def run(self, seconds: float, between: Between) -> None:
        """Run for some time [s], or until a KeyboardInterrupt; `between` is called each period."""
        period = self._config.period
        begun = self._clock.now() + period
        number, last = 0, round(seconds / period)
        try:
            while number < last:
                due = begun + number * period
                self._clock.sleep_until(due)
                self.turn(due)
                between(self._clock.now())
                # Periods that are gone as a whole are not begun.
                number += 1
                gone = int((self._clock.now() - begun) / period)
                if gone > number:
                    self.counts.skipped += min(gone, last) - number
                    number = gone
        finally:
            self._device.close()

    def turn(self, due: float) -> None:
        """One period, due at a time [s]."""
        woke = self._clock.now()
        counts = self.counts
        counts.periods += 1
        try:
            if self._is_there(woke):
                for message in self._device.read():
                    self._heed(message)
                if self._shadow.entered is not None:
                    self._control(woke, due)
            else:
                counts.unconnected += 1
        except DeviceLost:
            self._lose()
        done = self._clock.now()
        self.latencies.work.append(done - woke)
        if done <= due + self._config.period:
            counts.kept += 1
        else:
            counts.missed += 1

    @property
    def has_parcel(self) -> bool:
        """Whether a parcel is on the surface."""
        return self._shadow.entered is not None

    def _is_there(self, now: float) -> bool:
        """Whether the device is connected, if need be now."""
        if self._connected:
            return True
        if now < self._next_attempt:
            return False
        self.counts.attempts += 1
        try:
            self._device.connect()
        except DeviceLost:
            self._next_attempt = now + self._wait
            self._wait = min(2.0 * self._wait, self._config.longest_wait)
            return False
        self._connected = True
        self.counts.connected += 1
        return True

    def _lose(self) -> None:
        """The device is gone, and with it the parcel."""
        self._device.close()
        if self._connected:
            self.counts.lost += 1
        self._connected = False
        self._next_attempt = self._clock.now() + self._wait
        self._wait = min(2.0 * self._wait, self._config.longest_wait)
        self._shadow.leave()
        self._sent.clear()

    def _heed(self, message: Message) -> None:
        self._wait = self._config.first_wait  # it speaks
        if isinstance(message, Frame):
            self._see(message)
        elif isinstance(message, Entered):
            self._enter(message)
        elif isinstance(message, AxesTaken):
            self._note(message)
        elif isinstance(message, Left):
            self.counts.parcels[message.outcome] += 1
            self._shadow.leave()
            self._sent.clear()

    def _see(self, frame: Frame) -> None:
        self.counts.frames += 1
        self._latest_arrival = self._clock.now()
        if frame.number is None:
            return
        try:
            used = self._shadow.see(frame)
        except ValueError as error:  # a driver that says what is no pose cannot be trusted
            raise DeviceLost(str(error)) from None
        if used:
            self._latest_frame = frame.taken
        else:
            self.counts.frames_unused += 1

    def _enter(self, entered: Entered) -> None:
        try:
            self._shadow.enter(entered)
        except ValueError:
            self.counts.unfit += 1
            self._shadow.leave()
            return
        self._sent.clear()
        self._latest_arrival = self._clock.now()
        self._latest_frame = entered.at
        self._stopped = False
        self._policy.begin()
        self._arranger.ask(self._shadow.observe(entered.at))

    def _note(self, taken: AxesTaken) -> None:
        """What the device says of a command."""
        if taken.refused:
            self.counts.refused += 1
            self._shadow.forget(taken.command)
        else:
            self._shadow.taken(taken.command, taken.at)
        for sent in self._sent:
            if sent.command == taken.command and not taken.refused:
                send = max(0.0, taken.at - sent.decided)
                self.latencies.send.append(send)
                self.latencies.whole.append(sent.before + send + sent.turn)
        self._sent = [sent for sent in self._sent if sent.command > taken.command]

    def _control(self, woke: float, due: float) -> None:
        """Estimate, decide and send for the parcel on the surface."""
        counts = self.counts
        observation = self._shadow.observe(self._clock.now())
        observed = self._clock.now()
        stopped = observed - self._latest_arrival > self._config.watchdog
        counts.watchdog += stopped and not self._stopped
        self._stopped = stopped
        within = self._bounds.hold(observation)
        counts.strayed += not within
        command, resolver = self._command(observation, within and not stopped)
        if command is None:
            counts.held += 1
            return
        angles = self._shadow.resolve(resolver, command)
        if self._guard.fault(angles):
            counts.out_of_range += 1
            counts.held += 1
            return
        turn = self._shadow.longest_turn(angles)
        decided = self._clock.now()
        number = self._device.set_axes(angles)
        self._shadow.tell(number, self._clock.now())
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
        self._sent.append(Sent(number, decided, decided - self._latest_frame, turn))

    def _command(self, observation: Observation, trusted: bool) -> tuple[Command | None, Resolver]:
        """What to do, and how it is meant; None: leave the axes as they stand."""
        if not trusted:
            return self._arranger.layout(), self._by_fixed
        try:
            return self._policy.decide(observation), self._by_policy
        except ValueError:  # it gave what is no action
            self.counts.out_of_range += 1
            return None, self._by_policy
