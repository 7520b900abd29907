"""What beginning episodes again costs: the device's time, and the host's.

Episodes of Sort cannot be kept from ending without making other motion of them. So the parts of a
step that there are for resets' sake are marked on the device's own time line: what SAME_STEP does
after the lanes have moved (final observations and infos, starts placed, lanes begun), and what
keeps the starts coming. A device that waits there for the host is counted as busy with resets.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch

from benchmarks.gpu.lanes import DeviceLanes
from surface_gym.cuda.prefetch import Laid

STEPS = 256  # control periods whose parts are marked
Mark = Any


@dataclass(frozen=True)
class Resets:
    """What resets cost a batch."""

    name: str
    lanes: int
    share: float  # [-] of the device's time
    # [1/s] starts that a thread of the host draws and lays out while lanes are moved; fewer than
    # episodes begin, and the device waits.
    laid_out: float
    reset: float  # [s] of all lanes by the caller, seeded anew


class Clock(Protocol):
    """Marks moments, and tells the time between two."""

    def mark(self) -> Mark:
        """The moment at which all that was asked for before is done."""

    def seconds(self, begin: Mark, end: Mark) -> float:
        """[s] from one to the other."""


class DeviceClock:
    """Marks moments of a GPU's stream; the host does not wait."""

    _event: Any = torch.cuda.Event  # that torch has no types for

    def mark(self) -> Mark:
        event: Any = self._event(enable_timing=True)
        event.record()
        return event

    def seconds(self, begin: Mark, end: Mark) -> float:
        end.synchronize()
        return 1e-3 * float(begin.elapsed_time(end))


class HostClock:
    """Marks moments of the host, which does one thing after the other."""

    def mark(self) -> Mark:
        return time.perf_counter()

    def seconds(self, begin: Mark, end: Mark) -> float:
        return float(end - begin)


class _Marked:
    """A function with a mark before and after each call."""

    def __init__(self, function: Callable[..., Any], clock: Clock) -> None:
        self._function = function
        self._clock = clock
        self.spans: list[tuple[Mark, Mark]] = []

    def __call__(self, *arguments: Any) -> Any:
        begin = self._clock.mark()
        result = self._function(*arguments)
        self.spans.append((begin, self._clock.mark()))
        return result

    def seconds(self) -> float:
        """[s] of all calls together."""
        return sum(self._clock.seconds(*span) for span in self.spans)


class _Timed:
    """What lays out starts, timed by the host's clock in the thread that it runs in."""

    def __init__(self, function: Callable[..., Laid]) -> None:
        self._function = function
        self.starts = 0
        self.taken = 0.0  # [s]

    def __call__(self, *arguments: Any) -> Laid:
        begin = time.perf_counter()
        laid = self._function(*arguments)
        self.taken += time.perf_counter() - begin
        self.starts += len(laid.lanes)
        return laid


def resets_of(contender: DeviceLanes, clock: Clock, steps: int = STEPS) -> Resets:
    """What resets cost a batch that has been moved before.

    Args:
        contender: the batch, its episodes in all stages.
        clock: of its device.
        steps: control periods over which it is watched.
    """
    env, supply = contender.env, contender.env.batch.supply
    again, follow = _Marked(env._begin_again, clock), _Marked(supply.follow, clock)
    laying = _Timed(supply._prepare)
    env._begin_again, supply.follow, supply._prepare = again, follow, laying
    try:
        begin = clock.mark()
        contender.step(steps)
        whole = clock.seconds(begin, clock.mark())
    finally:
        del env._begin_again, supply.follow, supply._prepare  # the classes' are seen again
    return Resets(
        contender.name,
        contender.lanes,
        (again.seconds() + follow.seconds()) / whole,
        laying.starts / laying.taken if laying.starts else 0.0,
        contender.reset,
    )


def clock_of(device: torch.device) -> Clock:
    """The clock of a device."""
    return DeviceClock() if device.type == "cuda" else HostClock()
