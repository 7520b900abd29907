"""Legs of a run. At each one's beginning a checkpoint is saved, everything is seeded anew from the
run's seed and the leg, and all lanes start anew: a run that goes on from a checkpoint does the same
at the same place, and so comes to the same as one that was not broken off.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from .config import TrainConfig

CURVE_EVERY = 10_000  # control periods from row to row of the curve

Progress = Callable[[int, float], None]  # control periods done, success of the latest episodes


@dataclass(frozen=True)
class Learned:
    """How a run ended."""

    steps: int  # control periods learned from
    seconds: float  # it took, this time
    interrupted: bool


@dataclass(frozen=True)
class News:
    """What a run tells while it goes on."""

    steps: int  # control periods done
    success: float | None  # of the latest episodes; None: as last told
    files: dict[str, bytes] = field(default_factory=dict)  # of its folder, where it is elsewhere


def leg_at(config: TrainConfig, steps: int) -> int:
    """Number of the leg that a run is in after some control periods."""
    return steps // config.checkpoint_every


def leg_seed(config: TrainConfig, leg: int) -> int:
    """Seed of all that is drawn in a leg."""
    return config.seed + 1_000_003 * leg
