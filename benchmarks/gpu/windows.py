"""How a contender is timed: in windows of many decisions, of which the median counts."""

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class Effort:
    """How long a contender is timed."""

    windows: int = 5
    # Decisions of a window, at least. Episodes of Sort with random actions have 18: each lane ends
    # 14 of them.
    steps: int = 256
    seconds: float = 0.5  # [s] of a window, at least
    chunk: int = 64  # decisions between two looks at the clock
    # Decisions before the first window: lanes that began together then end at different times.
    settling: int = 192


class Contender(Protocol):
    """Lanes that are moved together."""

    name: str
    lanes: int
    first: float  # [s] until the first reset was done, compilation included

    def step(self, steps: int) -> None:
        """Move all lanes over so many decisions, and wait until that is done."""

    def begun(self) -> int:
        """Episodes that have begun so far, of all lanes; 0 where none ends."""


@dataclass(frozen=True)
class Rate:
    """How fast a contender is."""

    name: str
    lanes: int
    decisions: float  # [1/s] of all lanes together
    episodes: float  # [1/s] that end and begin, of all lanes together
    first: float  # [s] until the first reset was done, compilation included; not in the rate


def rate_of(contender: Contender, effort: Effort) -> Rate:
    """Time a contender, warmed up."""
    contender.step(effort.settling)
    decisions, episodes = [], []
    for _ in range(effort.windows):
        before, steps, begin = contender.begun(), 0, time.perf_counter()
        while steps < effort.steps or time.perf_counter() - begin < effort.seconds:
            contender.step(effort.chunk)
            steps += effort.chunk
        taken = time.perf_counter() - begin
        decisions.append(steps * contender.lanes / taken)
        episodes.append((contender.begun() - before) / taken)
    return Rate(
        contender.name,
        contender.lanes,
        float(np.median(decisions)),
        float(np.median(episodes)),
        contender.first,
    )
