"""What bears a parcel that moves straight along a line: columns of rotors, supports beside them."""

from dataclasses import dataclass
from math import gamma

import numpy as np

from surface_gym.lines import Line
from surface_gym.settings import Settings

from ..sight import LineSight
from .lane_rule import Booleans, Numbers

ON_EDGE = 1e-6  # [m] an element so near the outline bears: observations are single precision
RECTANGLE = 0.999  # [-] of its rectangle that a base fills at least which is one
# Exponents of the ovals |x / a|^p + |y / b|^p = 1 that others are taken for; how much they fill.
POWERS = np.geomspace(1.2, 60.0, 200)
FILLS = np.array([gamma(1.0 + 1.0 / p) ** 2 / gamma(1.0 + 2.0 / p) for p in POWERS])


@dataclass(frozen=True, eq=False)
class Footing:
    """Rows of elements under a parcel, rotors or supports, each as far as the base covers it."""

    place: Numbers  # (lanes,) [m] x of the base's centroid past the zone's first edge
    middle: Numbers  # (lanes,) [m] from the centroid to the middle of the base's length
    load: Numbers  # (lanes,) [m] from the centroid to the load, along x
    half_length: Numbers  # (lanes,) [m]
    row_reach: Numbers  # (lanes, rows) [m] covered of a row to either side of `middle`; -1: none
    rotor: Booleans  # (lanes, rows) the row is of rotors

    @property
    def rotor_share(self) -> Numbers:
        """(lanes,) [-] of the elements under the parcel that are rotors, on average."""
        covered = np.maximum(0.0, self.row_reach)
        return (covered * self.rotor).sum(axis=1) / np.maximum(covered.sum(axis=1), ON_EDGE)


def footing(settings: Settings, see: LineSight) -> Footing:
    """That of parcels on a line; a base that is no rectangle is taken for as full an oval."""
    plant = settings.chosen_plant
    end = plant.pitch_x * settings.action_kind.columns
    rear = end - see.rear_to_go
    # The size shown is the way from the rear to the centroid, straight on.
    place = rear + see.reach
    half_length = np.maximum(0.5 * (see.front_in_zone - rear), 0.5 * plant.pitch_x)
    rows = settings.action_kind.rows + 2
    y = plant.pitch_y * (np.arange(rows) - (rows - 1) / 2.0) - see.offset[:, np.newaxis]
    aside = np.abs(y) / (see.half_width[:, np.newaxis] + ON_EDGE)
    power = _exponent(see.fill)[:, np.newaxis]
    part = np.maximum(0.0, 1.0 - np.minimum(aside, 1.0) ** power) ** (1.0 / power)
    part = np.where(see.fill[:, np.newaxis] > RECTANGLE, 1.0, part)
    row_reach = np.where(aside <= 1.0, part * half_length[:, np.newaxis] + ON_EDGE, -1.0)
    return Footing(
        place, 0.5 * (rear + see.front_in_zone) - place, see.load_ahead, half_length, row_reach,
        _rotor_rows(settings, see, rows),
    )  # fmt: skip


def _rotor_rows(settings: Settings, see: LineSight, rows: int) -> Booleans:
    """(lanes, rows) which are of rotors: of a line, as many as lie under the width."""
    plant = settings.chosen_plant
    most = settings.action_kind.rows
    if isinstance(plant, Line):
        under = np.floor((see.half_width + ON_EDGE) / plant.pitch_y).astype(np.int64)
        half = np.clip(under, 1, most // 2)
    else:
        half = np.full(len(see.theta), most // 2)
    from_middle = np.abs(np.arange(rows) - (rows - 1) / 2.0)
    rotor: Booleans = from_middle < half[:, np.newaxis]
    return rotor


def _exponent(fill: Numbers) -> Numbers:
    """(lanes,) of the oval that fills so much of its rectangle."""
    power: Numbers = np.interp(fill, FILLS, POWERS)
    return power
