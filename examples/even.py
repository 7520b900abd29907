"""A task on streams of your own: parcels leave by any exit, but exits are to be loaded evenly.

python train.py --task examples/even.py:Even
python evaluate.py --task examples/even.py:Even
surface-gym play --task examples/even.py:Even
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

import surface_gym.extend as own
from surface_gym.extend import THETA, VX, VY, EnvState, X, Y, kernel_function

LINE = own.flow_line(3.0)
EXITS = own.Exits(
    (own.Exit("left", 1, 0.0, 3.0), own.Exit("right", -1, 0.0, 3.0), own.Exit("straight", 0))
)
STREAM = own.Stream(own.Spread(rate=1500.0, spread=0.3), speeds=1.5)
LOAD = own.GOALS  # place in the goal of the parcels that took each exit, less those of the least
LEFT, RIGHT, STRAIGHT = range(3)  # of EXITS
FULL = 2  # parcels by which an exit may be ahead of another as one more takes it

TAKEN = 0  # place in what the task keeps of each exit: how many parcels took it
BEFORE = own.OWN_MEMORY  # place in the memory: [m] x at the last decision

FEATURES = (
    own.Feature("ahead", -10.0, 10.0, "x from the middle of the line / 1 m"),
    own.Feature("aside", -10.0, 10.0, "y from the middle of the line / 0.3 m"),
    own.Feature("sine of theta", -1.0, 1.0, ""),
    own.Feature("cosine of theta", -1.0, 1.0, ""),
    own.Feature("forward speed", -20.0, 20.0, "vx / 1 m/s"),
    own.Feature("lateral speed", -20.0, 20.0, "vy / 0.5 m/s"),
    own.Feature("load left", 0.0, 100.0, "parcels that took this exit more than another / 4"),
    own.Feature("load right", 0.0, 100.0, "in the same way"),
    own.Feature("load straight", 0.0, 100.0, "in the same way"),
    own.Feature("present", 0.0, 1.0, "1: there is a parcel; 0: none, and so is all else"),
    own.Feature("gap ahead", -20.0, 20.0, "to the next parcel along x / 0.5 m; 8: there is none"),
)
AHEAD, _, _, _, _, _, LOADS, _, _, PRESENT, GAP = range(len(FEATURES))


@dataclass(frozen=True)
class Even(own.StreamTask):
    """Lead parcels off to the left, to the right and straight on, as many by each exit.

    A parcel that takes an exit that is `FULL` parcels ahead of another departs wrongly.
    """

    stream: own.Stream = STREAM
    exits: Any = EXITS
    duration: float = 20.0
    max_parcels: int = 8

    line = LINE
    features = FEATURES
    terms = ("even", "uneven", "touch", "way", *own.SURFACE_TERMS)
    goals = own.GOALS + 3
    memories = own.OWN_MEMORY + 1

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        state.memory[BEFORE] = state.truth[X]

    @staticmethod
    @kernel_function
    def deliver(
        params: own.StreamParams, state: EnvState, taken: int, passed: own.Array, belt: float,
        runs: bool,
    ) -> tuple[bool, float, float]:  # fmt: skip
        if taken == own.BETWEEN:
            return False, math.nan, math.nan
        passed[TAKEN] += 1.0
        return state.goal[LOAD + taken] < FULL, math.nan, math.nan

    @staticmethod
    @kernel_function
    def inform(
        params: own.StreamParams, state: EnvState, passed: own.Array, belt: float, runs: bool,
        stops: bool,
    ) -> None:  # fmt: skip
        least = min(passed[LEFT, TAKEN], passed[RIGHT, TAKEN], passed[STRAIGHT, TAKEN])
        for k in range(3):
            state.goal[LOAD + k] = passed[k, TAKEN] - least

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        state.terms[0] = 1.0 if outcome == own.DEPARTED_CORRECT else 0.0
        state.terms[1] = -1.0 if outcome == own.DEPARTED_WRONG else 0.0
        state.terms[2] = -0.5 * state.memory[own.TOUCHED]
        state.terms[3] = 0.1 * (state.truth[X] - state.memory[BEFORE])
        state.memory[BEFORE] = state.truth[X]

    @staticmethod
    @kernel_function
    def observe(state: EnvState, waits: bool) -> None:
        sensed, see = state.sensed, state.observation
        see[0] = _within(sensed[X] - 1.5, 10.0)
        see[1] = _within((sensed[Y] - state.elements.line_y) / 0.3, 10.0)
        see[2] = math.sin(sensed[THETA])
        see[3] = math.cos(sensed[THETA])
        see[4] = _within(sensed[VX], 20.0)
        see[5] = _within(sensed[VY] / 0.5, 20.0)
        for k in range(3):
            see[LOADS + k] = min(100.0, state.goal[LOAD + k] / 4.0)
        see[PRESENT] = 1.0

    @staticmethod
    @kernel_function
    def observe_neighbour(state: EnvState, other: EnvState, gap: float, ahead: bool) -> None:
        if ahead:
            state.observation[GAP] = _within(gap / 0.5, 8.0)

    @staticmethod
    @kernel_function
    def observe_no_neighbour(state: EnvState, ahead: bool) -> None:
        if ahead:
            state.observation[GAP] = 8.0


@kernel_function
def _within(value: float, most: float) -> float:
    return min(most, max(-most, value))


class LeastLoaded:
    """Leads each parcel, from the foremost on, to the exit that is least loaded then."""

    # choices of the modules under a parcel, by exit: axes at -45 deg, 45 deg and 90 deg
    CHOICES = np.array([2, 1, 3])

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Return the action for a table (rows, features), or actions for (num_envs, ...)."""
        tables = np.atleast_3d(observation.T).T
        rows = np.arange(len(tables))
        chosen = np.full(tables.shape[:2], STRAIGHT)
        loads = 4.0 * tables[..., LOADS : LOADS + 3].max(axis=1)
        order = np.argsort(-np.where(tables[..., PRESENT] > 0.0, tables[..., AHEAD], -np.inf))
        for slots in order.T:
            exits = loads.argmin(axis=1)
            there = tables[rows, slots, PRESENT] > 0.0
            chosen[rows[there], slots[there]] = exits[there]
            loads[rows[there], exits[there]] += 1.0
        action = np.repeat(self.CHOICES[chosen], 2, axis=1)
        return action.reshape(*observation.shape[:-2], -1), state


own.register(Even, "Examples/Even-v0")
