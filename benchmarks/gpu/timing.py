"""Decisions per second of vectorised programs, and the share of time that resets take.

A program is timed in windows of many decisions; the result is the windows' median. Resets cannot be
left out without changing the motion. So their time is measured by marks on the device's time line
around two parts of a step: the reset of ended environments, and the update of prepared starts. If
the device waits for the host in between, this also counts as time of resets.
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
ACTIONS = 20  # random actions of every environment, which the CPU gets in turn
RESET_STEPS = 256  # control periods in which resets are timed


@dataclass(frozen=True)
class Effort:
    """Duration of a measurement."""

    windows: int = 5
    # Minimum decisions of a window. Episodes of Sort with random actions have 18 on average, so
    # each environment ends 14 episodes.
    steps: int = 256
    seconds: float = 0.5  # [s] minimum duration of a window
    chunk: int = 64  # decisions between two readings of the clock
    # Decisions before the first window, until environments end at different times.
    warm_up: int = 192


class Program(Protocol):
    """Environments that are stepped together."""

    name: str
    num_envs: int
    first: float  # [s] of the first reset, compilation included

    def step(self, steps: int) -> None:
        """Step all environments by a number of decisions, and wait for the device."""

    def episodes(self) -> int:
        """Return the number of episodes that all environments have begun; 0 without episodes."""


@dataclass(frozen=True)
class Rate:
    """Speed of a program."""

    name: str
    num_envs: int
    decisions: float  # [1/s] of all environments together
    episodes: float  # [1/s] that end and begin, of all environments together
    first: float  # [s] of the first reset, compilation included; not in the rate


def measure_rate(program: Program, effort: Effort) -> Rate:
    """Time a program after `effort.warm_up` decisions."""
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
    """Make vector environments of Sort with actions "halves" and autoreset in the same step."""
    return gym.make_vec(
        ID, num_envs=num_envs, task=task, actions="halves", autoreset_mode="SameStep", **arguments
    )


def make_streams(num_envs: int, **arguments: Any) -> Any:
    """Make vector environments of Flow with 16 parcels each and more arrivals than can enter."""
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
    """A vector environment on a device, with autoreset in the same step.

    Drawing the actions is part of the time. Only the first of two resets includes compilation.
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
        """Return the number of starts taken; 0 for streams, whose episodes last a minute."""
        prefetch = getattr(self.env.batch, "prefetch", None)
        return 0 if prefetch is None else int(prefetch.starts_taken.sum())

    def _reset(self) -> float:
        """Reset all environments, and return the time [s]."""
        begin = time.perf_counter()
        self.env.reset(seed=0)
        wait_for(self.env.device)
        return time.perf_counter() - begin


class HostProgram:
    """A vector environment on the CPU, with autoreset in the same step and actions drawn before."""

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
        """Return the number of episodes that have ended."""
        return self._episodes


Mark = Any


@dataclass(frozen=True)
class ResetCost:
    """Cost of a batch's resets."""

    name: str
    num_envs: int
    share: float  # [-] of the device's time
    # [1/s] starts that a thread of the host prepares during steps; the device waits if more
    # episodes begin
    starts: float
    reset: float  # [s] of all environments by the caller, seeded anew


class Clock(Protocol):
    """Marks moments, and measures the time between two marks."""

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
        """Wait for the later event, and return the time [s] between both events."""
        end.synchronize()
        return float(1e-3 * begin.elapsed_time(end))


class HostClock:
    """A clock of the host."""

    def mark(self) -> Mark:
        """Read the clock."""
        return time.perf_counter()

    def seconds(self, begin: Mark, end: Mark) -> float:
        """Return the difference [s]."""
        return float(end - begin)


class _Marked:
    """A function that sets a mark before and after each call."""

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
        """Return the total time [s] of all calls."""
        return sum(self._clock.seconds(*span) for span in self.spans)


class _Timed:
    """The function that prepares starts in a thread of the host, with its time and results."""

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
    """Measure the cost of resets in a number of control periods.

    The program must have been stepped before, so that episodes end at different times.
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
