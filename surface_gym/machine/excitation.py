"""Excitation: commands that make a machine show its parameters in a log."""

import math

import numpy as np

from surface_gym import checks
from surface_gym.layouts import ROLLING
from surface_gym.physics.types import Array

KINDS = ("coast", "brake", "steer")  # of successive runs
ROLL = 0.2  # [s] at the start, in which every run coasts
HOLD = (0.12, 0.3)  # [s] range of the time for which axes brake or steer
PAUSE = (0.06, 0.2)  # [s] range of the time for which they roll between


def excitation(
    shape: tuple[int, int], seconds: float, *, run: int = 0, period: float = 0.04
) -> Array:
    """Return the axes (periods, rows, columns) [rad] of a run to record.

    Runs of three kinds take turns: the parcel coasts; it is braked in short pulses; it is steered
    in short pulses of 45 deg to either side. All modules of the zone do the same. A dozen runs
    suffice for most parameters; runs of one kind do not.

    Args:
        shape: (rows, columns) of the widest zone.
        seconds: [s] duration.
        run: number of the run; equal numbers give equal commands.
        period: [s] between commands.
    """
    rows, columns = (checks.integer("shape", each, least=1) for each in shape)
    seconds = checks.positive("seconds", seconds, *checks.DURATION)
    period = checks.positive("period", period, *checks.CONTROL_PERIOD)
    kind = KINDS[checks.integer("run", run, least=0) % len(KINDS)]
    rng = np.random.default_rng([run, len(KINDS)])
    angles = np.full(max(1, round(seconds / period)), ROLLING)
    begin, side = ROLL + rng.uniform(*PAUSE), 1.0 if rng.random() < 0.5 else -1.0
    while kind != "coast" and begin < seconds:
        end = begin + rng.uniform(*HOLD)
        angle = 0.0 if kind == "brake" else side * 0.25 * math.pi
        angles[math.ceil(begin / period) : math.ceil(end / period)] = angle
        begin, side = end + (rng.uniform(*PAUSE) if rng.random() < 0.7 else 0.0), -side
    return np.broadcast_to(angles[:, np.newaxis, np.newaxis], (len(angles), rows, columns)).copy()
