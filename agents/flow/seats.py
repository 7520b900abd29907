"""Parcels of flows as Stable-Baselines3's environments: a seat follows one parcel from the gate on.

Seats learn by weights that all share. A parcel takes a seat when it comes up to the gate and leaves
it when it has left the line; a free seat sees zeros, and nothing it does counts.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.features import FEATURES
from surface_gym.flow.memory import JAM, NOBODY
from surface_gym.flow.rewards import PARCEL_TERMS
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.state import OUT_OF_TIME, RUNNING

from ..mirror import mirrored_orientations
from ..vec_env import SharedVecEnv
from .parcel_rule import SIDE

# [-] a seat's terms over the flow's: right, wrong, touch, reach, time
SCALES = np.array([1.0, 1.5, 2.0, 1.0, 0.5])
TIME = PARCEL_TERMS.index("time")  # to which waiting at the gate counts too
HEAD_REWARD = -3.0  # per second at the gate: what the line could have delivered meanwhile
JAM_REWARD = -1.0  # once, for each parcel of a line on which nothing moves any more


def seat_rows(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows of parcels (..., features) as seats see them: the side as one that is mirrored."""
    seen = rows.copy()
    seen[..., SIDE] = np.abs(rows[..., SIDE])
    return seen


def seat_space(settings: FlowSettings) -> tuple[spaces.Box, spaces.MultiDiscrete]:
    """What a seat sees; and what it says: choices ahead and behind, and when the gate opens."""
    choices, gates = settings.action_kind.choices, settings.flow_actions.gates
    return settings.row_space(), spaces.MultiDiscrete([choices, choices, gates])


class SeatActions:
    """Turns what seats say, seen in their mirrors, into what the flow is told.

    Args:
        settings: of the flow, with "parcels" for actions and a gate.
    """

    def __init__(self, settings: FlowSettings) -> None:
        self._image = mirrored_orientations(settings.chosen_orientations)

    def __call__(self, rows: NDArray[np.float32], said: NDArray[np.int64]) -> NDArray[np.int64]:
        """Actions (lanes, 2 places + 1) for tables (lanes, rows, features), by what each row says
        (lanes, rows, 3).
        """
        halves = said[:, :-1, :2]
        mirrored = (rows[:, :-1, SIDE] < 0.0)[..., np.newaxis]
        halves = np.where(mirrored, self._image[halves], halves)
        return np.concatenate([halves.reshape(len(said), -1), said[:, -1:, 2]], axis=1)

    def said(self, rows: NDArray[np.float32], actions: NDArray[np.int64]) -> NDArray[np.int64]:
        """What each row says (lanes, rows, 3), of actions (lanes, 2 places + 1): the way back."""
        lanes, count, _ = rows.shape
        said = np.zeros((lanes, count, 3), dtype=np.int64)
        halves = actions[:, :-1].reshape(lanes, count - 1, 2)
        mirrored = (rows[:, :-1, SIDE] < 0.0)[..., np.newaxis]
        said[:, :-1, :2] = np.where(mirrored, self._image[halves], halves)
        said[:, -1, 2] = actions[:, -1]
        return said


class FlowSeats(SharedVecEnv):
    """Seats on lanes of one flow.

    Args:
        settings: of the flow, with "parcels" for actions and a gate.
        lanes: number of surfaces.
        seats: on each.
        stream_of: the stream of an episode, drawn by a generator.
    """

    def __init__(
        self,
        settings: FlowSettings,
        lanes: int,
        seats: int,
        stream_of: Callable[[np.random.Generator], Stream],
    ) -> None:
        self._batch = FlowBatch(settings, lanes)
        self._stream_of = stream_of
        self._actions = SeatActions(settings)
        self._lanes, self._seats, self._rows = lanes, seats, settings.rows
        self._features = len(FEATURES)
        self._period = settings.control_period
        self._who = np.full((lanes, seats), NOBODY)  # which arrival sits where
        self._row = np.zeros((lanes, seats), dtype=np.int64)  # and in which row it is
        self._returns = np.zeros((lanes, seats))
        self._terms = np.zeros((lanes, seats, len(SCALES)))
        self._lengths = np.zeros((lanes, seats), dtype=np.int64)
        self._rng = np.random.default_rng(0)
        self.render_mode = None
        super().__init__(lanes * seats, *seat_space(settings))

    @property
    def _shared(self) -> "FlowSeats":
        return self

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self._rng = np.random.default_rng(seed)
        for lane in range(self._lanes):
            self._batch.seed(lane, np.random.default_rng(self._rng.integers(2**63)))
        return [seed] * self.num_envs

    def reset(self) -> VecEnvObs:
        if not self._batch.is_seeded(0):
            self.seed(0)
        self._begin(np.arange(self._lanes))
        self._returns[:] = 0.0
        self._terms[:] = 0.0
        self._lengths[:] = 0
        self._follow()
        return self._look()

    def step_async(self, actions: NDArray[np.int64]) -> None:
        said = np.zeros((self._lanes, self._rows, 3), dtype=np.int64)
        each = actions.reshape(self._lanes, self._seats, 3)
        lane, seat = np.nonzero(self._who != NOBODY)
        said[lane, self._row[lane, seat]] = each[lane, seat]
        tables = self._batch.observation
        self._batch.advance(self._actions(tables, said))

    def step_wait(self) -> VecEnvStepReturn:
        flows = self._batch.streams
        lane, seat = np.nonzero(self._who != NOBODY)
        who, row = self._who[lane, seat], self._row[lane, seat]
        waited = row == self._rows - 1
        gone = ~waited & ~flows.present[lane, row]
        entered = waited & (who < flows.coming[lane])
        # One that has entered is in some place now.
        found = (flows.number[lane][:, :-1] == who[:, np.newaxis]).argmax(axis=1)
        row = np.where(entered, found, row)
        gone |= entered & ~flows.present[lane, row]
        self._row[lane, seat] = row
        terms = self._batch.parcels.terms.reshape(self._lanes, self._rows, -1)[lane, row]
        paid = terms * SCALES
        paid[waited] = 0.0
        # One that has entered waited for half of the period, as far as is known here.
        paid[waited, TIME] = HEAD_REWARD * self._period * np.where(entered[waited], 0.5, 1.0)
        earned = np.zeros((self._lanes, self._seats, len(SCALES)))
        earned[lane, seat] = paid
        rewards = earned.sum(axis=2)
        dones = np.zeros((self._lanes, self._seats), dtype=np.bool_)
        dones[lane, seat] = gone
        outcome = flows.outcome
        over = outcome != RUNNING
        sits = self._who != NOBODY
        rewards[sits & (outcome == JAM)[:, np.newaxis]] += JAM_REWARD
        self._returns += rewards
        self._terms += earned
        self._lengths[sits] += 1
        last = self._look()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ends = dones | (sits & over[:, np.newaxis])
        right = np.zeros_like(rewards)
        right[lane, seat] = terms[:, 0]
        for i, k in np.argwhere(ends).tolist():
            infos[i * self._seats + k] = {
                "terminal_observation": last[i * self._seats + k],
                "TimeLimit.truncated": bool(outcome[i] == OUT_OF_TIME and not dones[i, k]),
                "is_success": bool(right[i, k] > 0.0),
                "outcome": self._batch.outcomes[outcome[i]],
                "reward_terms": dict(zip(PARCEL_TERMS, self._terms[i, k].tolist(), strict=True)),
                "episode": {
                    "r": float(self._returns[i, k]),
                    "l": int(self._lengths[i, k]),
                    "t": float(flows.clock[i]),
                },
            }
        self._who[ends] = NOBODY
        self._returns[ends] = 0.0
        self._terms[ends] = 0.0
        self._lengths[ends] = 0
        if over.any():
            self._begin(np.nonzero(over)[0])
        began = self._follow()
        for i, k in began:
            ends[i, k] = True  # what a free seat did ends where somebody takes it
        return self._look(), rewards.ravel().astype(np.float32), ends.ravel(), infos

    def _begin(self, lanes: NDArray[np.int64]) -> None:
        """Start episodes on some lanes."""
        options = [{"stream": self._stream_of(self._rng)} for _ in lanes]
        self._batch.start(lanes, options)
        self._who[lanes] = NOBODY

    def _follow(self) -> list[list[int]]:
        """Seat who has come up to the gate; which seats were taken."""
        flows = self._batch.streams
        head = flows.number[:, -1]
        new = (head != NOBODY) & ~(self._who == head[:, np.newaxis]).any(axis=1)
        taken = []
        for lane in np.nonzero(new)[0].tolist():
            free = np.nonzero(self._who[lane] == NOBODY)[0]
            if len(free) > 0:
                self._who[lane, free[0]] = head[lane]
                self._row[lane, free[0]] = self._rows - 1
                taken.append([lane, int(free[0])])
        return taken

    def _look(self) -> NDArray[np.float32]:
        """(seats of all lanes, features)."""
        tables = self._batch.observation
        seen = np.zeros((self._lanes, self._seats, self._features), dtype=np.float32)
        lane, seat = np.nonzero(self._who != NOBODY)
        seen[lane, seat] = seat_rows(tables[lane, self._row[lane, seat]])
        return seen.reshape(self.num_envs, -1)

    def close(self) -> None:
        """Nothing is open."""
