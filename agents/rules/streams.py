"""Rules for streams of parcels that decide for each parcel alone."""

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.flow.task import COLUMN
from surface_gym.tasks import Sort
from surface_gym.tasks.features import read

from .. import library
from ..base import BatchController, find_axes
from .base import CompiledController, rule
from .slopes import ROLL, TO_LEFT, TO_RIGHT

Rows = NDArray[np.float32]
Halves = NDArray[np.int64]

OWN = len(Sort.features)  # number of Sort's features, the first of a row
OPEN = 1  # the gate opens at the first physics step, if there is room


class ParcelRule(BatchController):
    """A rule that decides for each parcel from its row alone."""

    def __init__(self, config: EnvConfig) -> None:
        checks.one_of("actions", config.actions, ("parcels",))
        if config.action_kind.continuous:
            raise ValueError(f"orientations must be some on offer, got {config.orientations!r}")
        self._axes = axes = find_axes(config)
        self.choices = np.array([axes.roll, axes.brake, axes.left, axes.right])  # by half
        self._shape = (config.rows, len(config.features))
        self._places = config.stream_task.max_parcels
        self._gated = config.stream_task.gate

    @abstractmethod
    def halves(self, rows: Rows) -> Halves:
        """Choose orientations (parcels, 2) of modules ahead of and behind each centre."""

    def _predict(self, batch: Rows, *_: Any, **__: bool) -> tuple[Halves, None]:
        num_envs = len(batch)
        rows = batch[:, : self._places].reshape(-1, batch.shape[-1])
        present = (COLUMN.present.of(rows) > 0.5) & (COLUMN.waits.of(rows) < 0.5)
        choices = np.full((len(rows), 2), self._axes.roll)
        if present.any():
            choices[present] = self.halves(rows[present])
        actions = choices.reshape(num_envs, -1)
        if self._gated:
            actions = np.pad(actions, ((0, 0), (0, 1)), constant_values=OPEN)
        return actions, None


@compiled
def choose_by_exits(tables: Rows, halves: Halves) -> None:
    """Choose halves (num_envs, rows, 2): to a parcel's side once it is past its exit's start."""
    for i in range(tables.shape[0]):
        for k in range(tables.shape[1]):
            row, choice = tables[i, k], ROLL
            is_there = read(row, COLUMN.present) > 0.5 and read(row, COLUMN.waits) < 0.5
            side = read(row, COLUMN.side)
            if is_there and side != 0.0 and read(row, COLUMN.past_the_exit_s_start) > 0.0:
                choice = TO_LEFT if side > 0.0 else TO_RIGHT
            halves[i, k, 0] = halves[i, k, 1] = choice


@rule("event rule", "flow", actions="parcels")
class StreamEventRule(ParcelRule, CompiledController):
    """90 deg until the parcel's rear is past its exit's start, then 45 deg under it."""

    kernel = staticmethod(choose_by_exits)

    def halves(self, rows: Rows) -> Halves:
        found = np.zeros((1, len(rows), 2), dtype=np.int64)
        self.kernel(rows[np.newaxis], found)
        return self.choices[found[0]]

    def begin(self) -> tuple[Any, ...]:
        rows = self._shape[0]
        tables = np.zeros((1, *self._shape), dtype=np.float32)
        return tables, np.zeros((1, rows, 2), dtype=np.int64)


@rule("sort-ppo", "flow", actions="parcels")
class SortEach(ParcelRule):
    """An unchanged shipped agent of Sort; a parcel's row begins with Sort's observation.

    Parcels with an exit straight ahead roll, since the agent was not trained on them.
    """

    def __init__(self, config: EnvConfig, name: str = "sort-ppo", seed: int = 0) -> None:
        super().__init__(config)
        self.name, self.policy = name, library.load(name, seed)
        self._choices = config.action_kind.choices

    def halves(self, rows: Rows) -> Halves:
        choices = np.full((len(rows), 2), self._axes.roll)
        aside = COLUMN.side.of(rows) != 0.0
        if aside.any():
            actions, _ = self.policy.predict(rows[aside, :OWN])
            choices[aside] = np.stack(np.divmod(actions, self._choices), axis=-1)
        return choices
