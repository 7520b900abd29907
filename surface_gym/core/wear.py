"""Turns and loads of modules in infos: wear, energy of axes, and overloads."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import state as st
from surface_gym.actions import SAME
from surface_gym.config import EnvConfig
from surface_gym.physics.types import GRAVITY, Integers
from surface_gym.state import SurfaceState


class WearMeter:
    """Counts the turns of each axis since a start, and reports wear, energy and loads.

    A turn begins when a standing axis starts to turn, or a turning axis gets a new target.
    """

    def __init__(self, config: EnvConfig, surfaces: SurfaceState) -> None:
        self._info, self._actuators, self._asked = config.info, config.actuators, config.has_extras
        self._period = math.tau if config.module_kind.drives else math.pi
        shape = surfaces.axis.shape if "turns" in config.info else (0,)
        self.turns = np.zeros(shape, dtype=np.int64)  # (num_envs, rows, columns)
        self.moving = np.zeros(shape, dtype=np.bool_)  # whether they turned in the last period

    def look(self, surfaces: SurfaceState, outcome: Integers) -> tuple[Any, ...] | None:
        """Return the axes, their targets, and a mask of the environments that begin an episode.

        In these environments, `outcome` (num_envs,) is STARTING. If turns are not counted, return
        None.
        """
        if not self.turns.size:
            return None
        return st.axis_angles(surfaces), surfaces.target.copy(), outcome == st.STARTING

    def count(self, surfaces: SurfaceState, before: tuple[Any, ...] | None) -> None:
        """Count turns since `look` returned `before`. At an episode's start, turns are set to 0."""
        if before is None:
            return
        angle, target, begun = before
        apart = st.axis_angles(surfaces) - angle
        apart -= self._period * np.floor(apart / self._period + 0.5)
        moved = np.abs(apart) > SAME
        self.turns += moved
        if target.shape == moved.shape:  # else a turn is over within its period
            self.turns -= moved & self.moving & (surfaces.target == target)
        self.moving[:] = moved
        self.turns[begun], self.moving[begun] = 0, False

    def infos(self, surfaces: SurfaceState) -> dict[str, NDArray[Any]]:
        """Return the requested infos (num_envs, ...) by name."""
        found: dict[str, NDArray[Any]] = {}
        if not self._asked:
            return found
        actuators, turns = self._actuators, self.turns
        if turns.size:
            found["axis_turns"] = turns.copy()
            found["axis_energy"] = actuators.turn_energy * turns.sum(axis=(1, 2))
            found["axis_wear"] = turns.max(axis=(1, 2)) / actuators.turn_life
        if "load" in self._info:
            found["peak_load"] = surfaces.load[..., st.PEAK_LOAD] / GRAVITY
        if actuators.load_limit != math.inf:
            over = surfaces.load[..., st.PEAK_LOAD] > GRAVITY * actuators.load_limit
            found["overloaded"] = np.asarray(over.any(axis=(1, 2)))
        return found
