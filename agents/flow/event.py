"""The event rule, parcel by parcel: roll until past the exit's start, then turn off."""

import numpy as np

from .parcel_rule import PAST_START, SIDE, Halves, ParcelRule, Rows


class EventRule(ParcelRule):
    """90 deg until the parcel's rear is past its exit's start, then 45 deg under it."""

    def _halves(self, rows: Rows) -> Halves:
        side = np.where(rows[:, PAST_START] > 0.0, rows[:, SIDE].astype(np.float64), 0.0)
        choice = self._axes.towards(side)
        return np.stack([choice, choice], axis=-1)
