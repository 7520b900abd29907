"""The model below the choice of a pattern, held against a step of the physics itself."""

import math

import numpy as np
import pytest

from surface_gym.agents.rules.patterns import (
    MOST_BELOW,
    PATTERNS,
    Patterns,
    PatternTuning,
    choose_action,
    find_below,
    find_centre,
    find_moments,
    find_place,
    predict_motion,
    prepare_axes,
    read_grid,
)  # fmt: skip
from surface_gym.agents.rules.slopes import ROLL, make_parcels, read_parcels
from surface_gym.config import EnvConfig
from surface_gym.flow.take_away import COLUMN, bulk
from surface_gym.randomisation import Actuators
from surface_gym.tasks.features import read
from tests.environments import begun

STARTS, SEED = 6, 11


class Slope:
    """A surface with one parcel, whose modules all follow a pattern."""

    def __init__(self, axis_speed: float) -> None:
        actuators = Actuators(axis_speed=axis_speed)
        stream = bulk(900.0)
        self.config = EnvConfig("singulate", max_parcels=1, stream=stream, actuators=actuators)
        self.rule = Patterns(self.config)
        self.grid = read_grid(self.config, PatternTuning(lag=0.0))
        self.arguments = self.rule.begin()
        self.batch = begun(self.config, seed=SEED)
        self.parcels = make_parcels(1)

    @property
    def row(self) -> np.ndarray:
        return self.batch.observation[0, 0]

    def look(self) -> np.ndarray:
        """The parcel's velocity."""
        _, slope, tuning, *_ = self.arguments
        read_parcels(self.batch.observation[0], slope, tuning, self.parcels)
        return np.array(
            [each[0] for each in (self.parcels.vx, self.parcels.vy, self.parcels.omega)]
        )

    def actions(self, pattern: int) -> np.ndarray:
        x, y = find_centre(self.parcels, self.row, 0)
        return np.array(
            [
                choose_action(pattern, find_place(dx - x, dy - y, r + c))
                for r, dy in enumerate(self.grid.y)
                for c, dx in enumerate(self.grid.x)
            ]
        )

    def step(self, actions: np.ndarray) -> np.ndarray:
        self.batch.step(self.rule.choices[actions][np.newaxis])
        return self.look()

    def predict(self, pattern: int, axes: np.ndarray) -> np.ndarray:
        below, rolls = self.arguments[7], self.arguments[1].rolls
        count = find_below(self.grid, self.parcels, self.row, 0, axes, below)
        assert 4 <= count < MOST_BELOW
        length, width = (read(self.row, each) for each in (COLUMN.length, COLUMN.width))
        prepare_axes(self.grid, below, count, (length**2 + width**2) / 3.0)
        moments = find_moments(below, count)
        return np.array(
            predict_motion(self.grid, rolls, below, count, moments, *self.look(), pattern)
        )


@pytest.mark.parametrize(
    ("axis_speed", "most"),
    [(math.inf, (0.006, 0.009, 0.09)), (0.5 * math.pi / 0.05, (0.009, 0.018, 0.15))],
)
def test_each_pattern_moves_a_parcel_as_predicted(
    axis_speed: float, most: tuple[float, ...]
) -> None:
    slope, rng = Slope(axis_speed), np.random.default_rng(SEED)
    errors, changes = [], []
    for _ in range(STARTS):
        while read(slope.row, COLUMN.present) < 0.5 or not 1.0 < slope.parcels.x[0] < 3.0:
            slope.step(np.full(slope.batch.config.action_kind.size, ROLL))
        for _ in range(3):  # it moves aside and turns
            actions = slope.actions(int(rng.integers(len(PATTERNS))))
            slope.step(actions)
            slope.step(actions)  # axes have turned
        axes, before = slope.grid.angles[actions], slope.look()
        snapshot = slope.batch.snapshot()
        for pattern in range(len(PATTERNS)):
            slope.look()
            predicted = slope.predict(pattern, axes)
            found = slope.step(slope.actions(pattern))
            errors.append(np.abs(found - predicted))
            changes.append(np.abs(found - before))
            slope.batch.restore(snapshot)
        slope.look()
        while read(slope.row, COLUMN.present) > 0.5:
            slope.step(np.full(slope.batch.config.action_kind.size, ROLL))
    # Modules that a parcel leaves or reaches within the period are the model's main error.
    assert (np.median(errors, axis=0) < most).all()
    assert (np.percentile(errors, 95, axis=0) < np.percentile(changes, 95, axis=0)).all()
