"""Which parcel a module obeys, against a slow account of who will bear it first."""

import math
from typing import Any

import numpy as np
import pytest

from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import NOBODY, TURNS
from surface_gym.physics.types import VX, VY, Array, X, Y
from surface_gym.randomisation import Actuators
from surface_gym.sensors import Exact, Presence
from tests.flow import flows

STUCK = ((8, 9), (10, 15))
FULL = flows.trace(*[(0.0, "left 1")] * 12)


def while_over(low: float, high: float, speed: float, place: float) -> tuple[float, float]:
    """[s] from when and until when an interval that moves at a speed holds a place."""
    if speed == 0.0:
        return (-math.inf, math.inf) if low <= place <= high else (math.inf, -math.inf)
    first, last = sorted(((place - high) / speed, (place - low) / speed))
    return first, last


def slow_claims(batch: StreamBatch, sensed: Array, present: Array, ahead: float) -> Array:
    """(rows, columns) the place that each module obeys, module by module and parcel by parcel."""
    first_row, rows, first, columns = batch.config.site.zone
    owner = np.full(batch.config.site.rotor.shape, NOBODY)
    for row in range(first_row, first_row + rows):
        for column in range(first, first + columns):
            x, y = 0.05 + 0.1 * column, 0.05 + 0.1 * row
            claims = []
            for place in np.nonzero(present)[0].tolist():
                pose = sensed[place]
                rear, front, right, left = flows.box_of(batch.parcel(0, place), pose[:3])
                along = while_over(rear, front, pose[VX], x)
                across = while_over(right, left, pose[VY], y)
                since, until = max(0.0, along[0], across[0]), min(ahead, along[1], across[1])
                if since <= until:
                    claims.append((since, math.hypot(x - pose[X], y - pose[Y]), place))
            if claims:
                owner[row, column] = min(claims)[2]
    return owner


def scattered(rng: np.random.Generator, count: int) -> Array:
    """(count, 6) poses and velocities all over the rotors."""
    return np.column_stack([
        rng.uniform(0.2, 2.2, count), flows.SHORT.line_y + rng.uniform(-0.4, 0.4, count),
        rng.uniform(-3.0, 3.0, count), rng.uniform(-1.0, 3.0, count),
        rng.uniform(-2.0, 2.0, count), rng.uniform(-1.0, 1.0, count),
    ])  # fmt: skip


class TestRule:
    @pytest.mark.parametrize("ahead", [0.0, 0.03, 0.1, 0.5])
    def test_is_the_slow_one_on_random_poses(self, ahead: float) -> None:
        rng = np.random.default_rng(0)
        batch = flows.batch_with(FULL, actions="parcels", ahead=ahead, duration=9.0)
        claimed = 0
        for _ in range(12):
            batch.reset(np.array([0]))
            flows.set_down(batch, scattered(rng, 12)[:, :3])
            # A sensor may see them anywhere; some stand still in x or in y.
            sensed = scattered(rng, 12)
            sensed[:3, VX] = 0.0
            sensed[2:5, VY] = 0.0
            batch.parcels.sensed[:12] = sensed
            batch.streams.present[0, 5] = False
            present = batch.streams.present[0].copy()
            batch.step(flows.command(batch, flows.BRAKE))
            wanted = slow_claims(batch, sensed, present, ahead)
            np.testing.assert_array_equal(batch.streams.owner[0], wanted)
            claimed += int((wanted != NOBODY).sum())
        assert claimed > 100

    @pytest.mark.parametrize("stray", [math.nan, math.inf, 1e12])
    def test_a_lost_estimate_claims_nothing(self, stray: float) -> None:
        owner = self.owners([(0.7, 1.0, 0.0), (1.5, 1.0, 0.0)], (stray, 1.5))
        assert set(np.unique(owner)) == {NOBODY, 1}

    def test_of_two_that_it_bears_the_nearer_is_obeyed(self) -> None:
        # Seen to overlap around x = 0.9.
        owner = self.owners([(0.75, 1.0, 0.0), (1.0, 1.0, 0.0)], (0.80, 1.0))
        assert (owner[9:11, 8] == 0).all()  # at x = 0.85
        assert (owner[9:11, 9] == 1).all()  # at x = 0.95

    def owners(self, poses: list[tuple[float, float, float]], sensed: tuple[float, float]) -> Array:
        """Whom the modules obey where two parcels are sensed at an x [m] each."""
        batch = flows.batch_with(FULL, actions="parcels", duration=9.0)
        flows.set_down(batch, poses)
        batch.parcels.sensed[:2, X] = sensed
        batch.step(flows.command(batch, flows.BRAKE))
        return batch.streams.owner[0]


class TestCommands:
    @pytest.mark.parametrize("orientations", [None, "any"])
    def test_modules_follow_the_half_of_their_owner(self, orientations: Any) -> None:
        batch = flows.batch_with(
            flows.DENSE, actuators=Actuators(stuck=STUCK), duration=4.0, actions="parcels",
            orientations=orientations, sensors=Presence() if orientations else Exact(),
        )  # fmt: skip
        kind = batch.config.action_kind
        rng = np.random.default_rng(2)
        commanded = np.full(batch.config.site.rotor.shape, math.pi / 2)
        turns = 0
        claimed = np.zeros_like(batch.config.site.rotor)
        for period in range(75):
            if period % 4 == 0:
                drawn = rng.integers(0, 4, (24, 2))
                if orientations == "any":
                    angles = drawn = rng.uniform(-1.5, 1.5, (24, 2))
                else:
                    angles = np.array(batch.config.chosen_orientations)[drawn]
            sensed = batch.parcels.sensed.copy()
            owner = slow_claims(batch, sensed, batch.streams.present[0], 0.1)
            before = commanded.copy()
            for row, column in np.argwhere(owner != NOBODY):
                place = owner[row, column]
                if batch.config.site.rotor[row, column] and (row, column) not in STUCK:
                    behind = 0.05 + 0.1 * column < sensed[place, X]
                    commanded[row, column] = angles[place, int(behind)]
            # An axis that was turned by pi is the same axis.
            turns += int((np.abs(np.sin(commanded - before)) > 1e-9).sum())
            batch.step(kind.commands(drawn.reshape(1, -1), 1))
            np.testing.assert_array_equal(batch.streams.commanded[0], commanded)
            assert batch.streams.tally[0, TURNS] == turns
            claimed |= owner != NOBODY
        assert claimed[:, 5:19].sum() > 30
        assert (commanded[:, :5] == math.pi / 2).all()
        assert all(commanded[module] == math.pi / 2 for module in STUCK)

    def test_boxes_are_those_of_turned_bases(self) -> None:
        """What the slow account rests on: a square turned by 45 deg is sqrt(2) as wide."""
        half = 0.125 * math.sqrt(2.0)
        box = flows.box_of(flows.BOX, (1.0, 2.0, math.pi / 4))
        assert box == pytest.approx((1.0 - half, 1.0 + half, 2.0 - half, 2.0 + half))
