"""Decisions a second of vectorised programs, and the share of time that resets take.

A program is timed in windows of many decisions, of which the median counts. Episodes of Sort cannot
be kept from ending without changing their motion. So the parts of a step that serve resets are
marked on the device's own time line: what SAME_STEP does after the step (final observations and
infos, starts placed, environments begun), and what prepares later starts. A device that waits there
for the host counts as busy with resets.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import torch

from surface_gym.cuda.prefetch import PreparedStarts
from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.stream import Stream
from surface_gym.registration import DEFAULT_STREAM, env_id
from surface_gym.tasks.sort import Sort

ID = "SmartSurface/Sort-v0"
MAX_PARCELS = 16  # on a line
PARCELS_PER_HOUR = 9000.0
ACTIONS = 20  # random actions of every environment that the CPU is given in turn
RESET_STEPS = 256  # control periods whose parts are marked


@dataclass(frozen=True)
class Effort:
    """Duration of a measurement."""

    windows: int = 5
    # Decisions of a window, at least. Episodes of Sort with random actions have 18: each
    # environment ends 14 of them.
    steps: int = 256
    seconds: float = 0.5  # [s] of a window, at least
    chunk: int = 64  # decisions between two readings of the clock
    # Decisions before the first window, so that environments that began together end at different
    # times.
    warm_up: int = 192


class Program(Protocol):
    """Environments that are stepped together."""

    name: str
    num_envs: int
    first: float  # [s] of the first reset, compilation included

    def step(self, steps: int) -> None:
        """Step all environments by so many decisions, and wait until that is done."""

    def episodes(self) -> int:
        """Return the episodes begun so far, of all environments; 0 where none ends."""


@dataclass(frozen=True)
class Rate:
    """Speed of a program."""

    name: str
    num_envs: int
    decisions: float  # [1/s] of all environments together
    episodes: float  # [1/s] that end and begin, of all environments together
    first: float  # [s] of the first reset, compilation included; not in the rate


def measure_rate(program: Program, effort: Effort) -> Rate:
    """Time a program, warmed up."""
    program.step(effort.warm_up)
    decisions, episodes = [], []
    for _ in range(effort.windows):
        before, steps, begin = program.episodes(), 0, time.perf_counter()
        while steps < effort.steps or time.perf_counter() - begin < effort.seconds:
            program.step(effort.chunk)
            steps += effort.chunk
        taken = time.perf_counter() - begin
        decisions.append(steps * program.num_envs / taken)
        episodes.append((program.episodes() - before) / taken)
    medians = float(np.median(decisions)), float(np.median(episodes))
    return Rate(program.name, program.num_envs, *medians, program.first)


def make_sort(task: Sort, num_envs: int, **arguments: Any) -> Any:
    """Make Sort with "halves"; an environment that ends begins again in the same step."""
    return gym.make_vec(
        ID, num_envs=num_envs, task=task, actions="halves", autoreset_mode="SameStep", **arguments
    )


def make_streams(num_envs: int, **arguments: Any) -> Any:
    """Make lines for 16 parcels each, with more arrivals than can enter."""
    return gym.make_vec(
        env_id(DEFAULT_STREAM),
        num_envs=num_envs,
        stream=Stream(Poisson(PARCELS_PER_HOUR)),
        max_parcels=MAX_PARCELS,
        actions="parcels",
        **arguments,
    )


def wait_for(device: torch.device) -> None:
    """Wait until a device has done all its work."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


class DeviceProgram:
    """A vector environment of tensors; actions are drawn on its device, and timed as well.

    Args:
        name: of the program.
        env: with autoreset in the same step. It is reset twice, so that the time of compiling, in
            the first reset only, is known apart.
    """

    def __init__(self, name: str, env: Any) -> None:
        self.name = name
        self.num_envs: int = env.num_envs
        self.env = env
        space = env.single_action_space
        self._choices = int(np.max(space.n if hasattr(space, "n") else space.nvec))
        self._shape = (self.num_envs, *space.shape)
        self._generator = torch.Generator(env.device).manual_seed(0)
        self.first = self._reset()
        self.reset = self._reset()  # [s] of all environments, seeded anew

    def step(self, steps: int) -> None:
        """Step all environments by random actions."""
        device = self.env.device
        for _ in range(steps):
            actions = torch.randint(
                self._choices, self._shape, device=device, generator=self._generator
            )
            self.env.step(actions)
        wait_for(device)

    def episodes(self) -> int:
        """Return the starts taken so far; of a stream none, since its episodes last a minute."""
        prefetch = getattr(self.env.batch, "prefetch", None)
        return 0 if prefetch is None else int(prefetch.starts_taken.sum())

    def _reset(self) -> float:
        """Reset all environments, and return the time [s]."""
        begin = time.perf_counter()
        self.env.reset(seed=0)
        wait_for(self.env.device)
        return time.perf_counter() - begin


class HostProgram:
    """The CPU's vector environment; its actions are drawn beforehand.

    Args:
        name: of the program.
        env: with autoreset in the same step.
    """

    def __init__(self, name: str, env: Any) -> None:
        self.name = name
        self.num_envs: int = env.num_envs
        self._env = env
        env.action_space.seed(0)
        self._actions = [env.action_space.sample() for _ in range(ACTIONS)]
        self._steps = 0
        self._episodes = 0
        begin = time.perf_counter()
        env.reset(seed=0)
        self.first = time.perf_counter() - begin

    def step(self, steps: int) -> None:
        """Step all environments by random actions."""
        for _ in range(steps):
            _, _, terminated, truncated, _ = self._env.step(self._actions[self._steps % ACTIONS])
            self._episodes += int(np.count_nonzero(terminated | truncated))
            self._steps += 1

    def episodes(self) -> int:
        """Return the episodes begun so far."""
        return self._episodes


Mark = Any


@dataclass(frozen=True)
class ResetCost:
    """Cost of a batch's resets."""

    name: str
    num_envs: int
    share: float  # [-] of the device's time
    # [1/s] starts that a thread of the host draws and lays out during steps; where fewer than
    # episodes begin, the device waits
    starts: float
    reset: float  # [s] of all environments by the caller, seeded anew


class Clock(Protocol):
    """Marks moments, and measures the time between two."""

    def mark(self) -> Mark:
        """Mark the moment at which all work requested before is done."""

    def seconds(self, begin: Mark, end: Mark) -> float:
        """Return the time [s] from one mark to another."""


class DeviceClock:
    """A clock of a GPU's stream; the host does not wait."""

    _event: Any = torch.cuda.Event  # untyped in torch

    def mark(self) -> Mark:
        """Record an event."""
        event = self._event(enable_timing=True)
        event.record()
        return event

    def seconds(self, begin: Mark, end: Mark) -> float:
        """Wait for the later event, and return the time [s] between both."""
        end.synchronize()
        return float(1e-3 * begin.elapsed_time(end))


class HostClock:
    """A clock of the host, which does one thing after the other."""

    def mark(self) -> Mark:
        """Read the clock."""
        return time.perf_counter()

    def seconds(self, begin: Mark, end: Mark) -> float:
        """Return the difference [s]."""
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
        """Return the time [s] of all calls together."""
        return sum(self._clock.seconds(*span) for span in self.spans)


class _Timed:
    """The function that prepares starts, timed by the host's clock in its thread."""

    def __init__(self, function: Callable[..., PreparedStarts]) -> None:
        self._function = function
        self.starts = 0
        self.taken = 0.0  # [s]

    def __call__(self, *arguments: Any) -> PreparedStarts:
        begin = time.perf_counter()
        prepared = self._function(*arguments)
        self.taken += time.perf_counter() - begin
        self.starts += len(prepared.env_indices)
        return prepared


def measure_resets(program: DeviceProgram, clock: Clock, steps: int = RESET_STEPS) -> ResetCost:
    """Measure the cost of resets of a batch whose episodes are in all stages.

    Args:
        program: the batch, stepped before.
        clock: of its device.
        steps: control periods to measure.
    """
    env, prefetch = program.env, program.env.batch.prefetch
    resetting, updating = _Marked(env._reset_ended, clock), _Marked(prefetch.update, clock)
    preparing = _Timed(prefetch._prepare)
    env._reset_ended, prefetch.update, prefetch._prepare = resetting, updating, preparing
    try:
        begin = clock.mark()
        program.step(steps)
        whole = clock.seconds(begin, clock.mark())
    finally:
        del env._reset_ended, prefetch.update, prefetch._prepare  # uncovers the methods
    return ResetCost(
        program.name,
        program.num_envs,
        (resetting.seconds() + updating.seconds()) / whole,
        preparing.starts / preparing.taken if preparing.starts else 0.0,
        program.reset,
    )


def device_clock(device: torch.device) -> Clock:
    """Return the clock of a device."""
    return DeviceClock() if device.type == "cuda" else HostClock()
