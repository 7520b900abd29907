"""A stream task of your own: parcels may leave by any exit, but all exits should get as many.

python train.py --task examples/even.py:Even
python evaluate.py --task examples/even.py:Even
surface-gym play --task examples/even.py:Even
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

import surface_gym.extend as own
from surface_gym import checks
from surface_gym.agents.rules import rule
from surface_gym.config import EnvConfig
from surface_gym.extend import THETA, VX, VY, EnvState, SurfaceView, X, Y, kernel_function

LINE = own.flow_line(3.0)
EXITS = own.Exits(
    (own.Exit("left", 1, 0.0, 3.0), own.Exit("right", -1, 0.0, 3.0), own.Exit("straight", 0))
)
STREAM = own.Stream(own.Spread(rate=1500.0, spread=0.3), speeds=1.5)
LOAD = own.GOALS  # index in the goal: parcels that took each exit, more than took the least used
LEFT, RIGHT, STRAIGHT = range(3)  # of EXITS
FULL = 2  # parcels that an exit may have more than another, before one more takes it

TAKEN = 0  # index in the memory of each exit: number of parcels that took it
BEFORE = own.OWN_MEMORY  # index in the memory: [m] x at the last decision

FEATURES = (
    own.Feature("ahead", -10.0, 10.0, "x from the middle of the line", "m", offset=1.5),
    own.Feature("aside", -10.0, 10.0, "y from the middle of the line", "m", 0.3),
    own.Feature("sine of theta", -1.0, 1.0),
    own.Feature("cosine of theta", -1.0, 1.0),
    own.Feature("forward speed", -20.0, 20.0, "vx", "m/s"),
    own.Feature("lateral speed", -20.0, 20.0, "vy", "m/s", 0.5),
    own.Feature("load left", 0.0, 100.0, "parcels that took this exit more than another", "", 4.0),
    own.Feature("load right", 0.0, 100.0, "the same", "", 4.0),
    own.Feature("load straight", 0.0, 100.0, "the same", "", 4.0),
    own.Feature("present", 0.0, 1.0, "1: there is a parcel; 0: none, and so is all else"),
    own.Feature("gap ahead", -8.0, 8.0, "to the next parcel along x; none: 4 m", "m", 0.5),
)
COLUMN = own.columns(FEATURES)
FAR = 4.0  # [m] to a parcel that is not there


@dataclass(frozen=True)
class Even(own.StreamTask):
    """Lead as many parcels to the left exit as to the right one and straight on.

    A departure is wrong if the exit already had `FULL` parcels more than another exit.
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
    exit_memories = 1

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        state.memory[BEFORE] = state.truth[X]

    @staticmethod
    @kernel_function
    def deliver(surface: SurfaceView, state: EnvState, taken: int, results: own.Array) -> bool:
        if taken == own.BETWEEN:
            return False
        surface.exits[taken, TAKEN] += 1.0
        return state.goal[LOAD + taken] < FULL

    @staticmethod
    @kernel_function
    def inform(surface: SurfaceView, state: EnvState) -> None:
        exits = surface.exits
        least = min(exits[LEFT, TAKEN], exits[RIGHT, TAKEN], exits[STRAIGHT, TAKEN])
        for k in range(3):
            state.goal[LOAD + k] = exits[k, TAKEN] - least

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
        own.show_within(see, COLUMN.ahead, sensed[X])
        own.show_within(see, COLUMN.aside, sensed[Y] - state.elements.line_y)
        own.show(see, COLUMN.sine_of_theta, math.sin(sensed[THETA]))
        own.show(see, COLUMN.cosine_of_theta, math.cos(sensed[THETA]))
        own.show_within(see, COLUMN.forward_speed, sensed[VX])
        own.show_within(see, COLUMN.lateral_speed, sensed[VY])
        own.show_within(see, COLUMN.load_left, state.goal[LOAD + LEFT])
        own.show_within(see, COLUMN.load_right, state.goal[LOAD + RIGHT])
        own.show_within(see, COLUMN.load_straight, state.goal[LOAD + STRAIGHT])
        own.show(see, COLUMN.present, 1.0)

    @staticmethod
    @kernel_function
    def observe_neighbour(state: EnvState, other: EnvState, gap: float, ahead: bool) -> None:
        if ahead:
            own.show_within(state.observation, COLUMN.gap_ahead, gap)

    @staticmethod
    @kernel_function
    def observe_no_neighbour(state: EnvState, ahead: bool) -> None:
        if ahead:
            own.show(state.observation, COLUMN.gap_ahead, FAR)


@rule("least loaded", "even", actions="parcels", is_prior=True)
class LeastLoaded:
    """Leads each parcel, the foremost first, to the exit with the fewest parcels until then."""

    # choices of the modules under a parcel, by exit: axes at -45 deg, 45 deg and 90 deg
    choices = np.array([2, 1, 3])

    def __init__(self, config: EnvConfig) -> None:
        checks.one_of("orientations", config.orientations, (None,))

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Return the action for a table (rows, features), or actions for tables (num_envs, ...)."""
        tables = np.atleast_3d(observation.T).T
        rows = np.arange(len(tables))
        chosen = np.full(tables.shape[:2], STRAIGHT)
        present = COLUMN.present.of(tables) > 0.0
        shown = (COLUMN.load_left, COLUMN.load_right, COLUMN.load_straight)
        loads = np.stack([each.of(tables).max(axis=1) for each in shown], axis=1)
        order = np.argsort(-np.where(present, COLUMN.ahead.of(tables), -np.inf))
        for slots in order.T:
            exits = loads.argmin(axis=1)
            there = present[rows, slots]
            chosen[rows[there], slots[there]] = exits[there]
            loads[rows[there], exits[there]] += 1.0
        action = np.repeat(self.choices[chosen], 2, axis=1)
        return action.reshape(*observation.shape[:-2], -1), state


own.register(Even, "Examples/Even-v0")
