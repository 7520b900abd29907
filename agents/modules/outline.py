"""A base's outline, and how many rows its line has, as far as an observation tells."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.lines import BaseLine, Line

from ..sight import LineSight

Numbers = NDArray[np.float64]

EXACT = 1e-6  # [m] lengths that differ by less are the same: observations are single precision
ELLIPSE = np.pi / 4.0  # share of a rectangle that the ellipse in it fills
ROUND = 0.08  # pitches that a disc, turned, may look narrower than a square; half a gap in rows


@dataclass(frozen=True, eq=False)
class Outline:
    """A base between a rectangle and the ellipse in it."""

    half: Numbers  # (2, lanes) [m] of its length and of its width
    roundness: Numbers  # (lanes,) [-] 0: a rectangle, 1: an ellipse
    rows: Numbers  # (lanes,) of the line it runs on

    def of(self, lane: NDArray[np.int64]) -> "Outline":
        """Those of some lanes (places,)."""
        return Outline(self.half[:, lane], self.roundness[lane], self.rows[lane])

    def reach(self, theta: Numbers) -> Numbers:
        """(lanes,) [m] that the base, turned by theta (lanes,) [rad], reaches along x."""
        cosine, sine = np.abs([np.cos(theta), np.sin(theta)])
        length, width = self.half
        straight = length * (cosine + sine) + (width - length) * sine
        bent = np.hypot(length * cosine, width * sine)
        return (1.0 - self.roundness) * straight + self.roundness * bent

    def outside(self, place: Numbers) -> Numbers:
        """(lanes,) [m] how far a place (2, lanes) [m] along and across the base is beyond it;
        negative under it. Beyond an ellipse it is farther than that, but for a disc.
        """
        straight = (np.abs(place) - self.half).max(axis=0)
        bent = (np.hypot(*(place / self.half)) - 1.0) * self.half.min(axis=0)
        return (1.0 - self.roundness) * straight + self.roundness * bent


def outline_shown(length: Numbers, width: Numbers, fill: Numbers, plant: BaseLine) -> Outline:
    """The outline of bases that are shown, by the features of the group "parcel" (lanes,)."""
    half = 0.175 + 0.05 * np.stack([length, width])
    return Outline(
        half,
        np.clip((1.0 - fill) / (1.0 - ELLIPSE), 0.0, 1.0),
        _rows(plant, half[1] / plant.pitch_y + EXACT),
    )


def outline_by_clearance(see: LineSight, clearance: Numbers, plant: BaseLine) -> Outline:
    """The outline of bases of which only half the length is shown: taken for rectangles, or discs.

    The clearance lacks the half line and what the base reaches across it. A wider base has a wider
    line, so that both follow.

    Args:
        see: the parcels, to be sorted to y > 0.
        clearance: (lanes,) [m] between the base and the line's rotors.
        plant: they run on.
    """
    length, pitch = see.half_length, plant.pitch_y
    cosine, sine = np.abs([np.cos(see.theta), np.sin(see.theta)])
    beyond = see.offset - clearance  # the half line, and what the base reaches
    across = beyond - length * sine  # the half line, and what half the width does
    rows = _rows(plant, (across / pitch + 1.5 - ROUND) / (1.0 + cosine))
    half_line = 0.5 * pitch * (rows - 1.0)
    reach = across - half_line
    as_wide = np.abs(reach - length * cosine) < EXACT
    is_disc = np.abs(beyond - half_line - length) < EXACT
    width = np.divide(reach, cosine, out=length.copy(), where=cosine > 0.0)
    width = np.where(as_wide | is_disc, length, np.clip(width, 0.5 * length, 2.0 * length))
    return Outline(np.stack([length, width]), np.zeros_like(length), rows)


def _rows(plant: BaseLine, pairs: Numbers) -> Numbers:
    """(lanes,) of a line under which `pairs` of rows find room; of any other plant, its own."""
    least = 2.0 if isinstance(plant, Line) else plant.zone_rows
    return np.clip(2.0 * np.floor(pairs), least, plant.zone_rows)
