"""Braking by columns of a line: how much each does, and the axes that do it."""

import math

import numpy as np
from numpy.typing import NDArray

from surface_gym.settings import Settings

from .axes import axes_of
from .lane_rule import Commands

Levels = NDArray[np.int64]
ROLL, HALF, FULL = range(3)  # of a column: 90 deg; 45 and -45 deg in turn; 0 deg
LEANS = np.array([0.0, math.pi / 4.0, math.pi / 2.0])  # [rad] of axes off 90 deg, by level


class ColumnAxes:
    """From the levels of a zone's columns to commands of "modules".

    Raises:
        ValueError: an orientation that a level needs is not on offer.
    """

    def __init__(self, settings: Settings) -> None:
        axes = axes_of(settings)
        rows = np.arange(settings.action_kind.rows)
        # In a column that brakes half, what pushes to the one side and to the other cancels out.
        in_turn = np.where(rows % 2, axes.right, axes.left)
        self._choice = np.stack(
            [np.full(len(rows), axes.roll), in_turn, np.full(len(rows), axes.brake)]
        )

    def __call__(self, levels: Levels) -> Commands:
        """Commands (lanes, rows x columns) for the levels (lanes, columns)."""
        commands: Commands = self._choice[levels].swapaxes(1, 2).reshape(len(levels), -1)
        return commands
