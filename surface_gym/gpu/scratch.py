"""How a lane's scratch is laid out on a GPU: as on a CPU, but with room for few contacts.

`dynamics.types` gives a scratch room for as many contacts as any parcel may have. On a GPU each of
many thousands of lanes has its own, in a thread's local memory: it is cut to the parcels at hand.
"""

import math
from collections.abc import Sequence
from types import MappingProxyType

import numpy as np

from surface_gym.bases import Base
from surface_gym.batch.sites import FEWEST_EDGES
from surface_gym.dynamics import types
from surface_gym.plants import Plant
from surface_gym.settings import Settings

# By name, as in `dynamics.types`.
ROWS_OF_TABLE = (
    "ARM_X", "ARM_Y", "AXIS_X", "AXIS_Y", "STIFFNESS", "MU_ALONG", "MU_ACROSS", "PRESSURE",
    "NORMAL", "MOST_ALONG", "MOST_ACROSS", "SLIP_ALONG", "SLIP_ACROSS", "FORCE_X", "FORCE_Y",
    "TORQUE", "CURVE_XX", "CURVE_XY", "CURVE_XW", "CURVE_YY", "CURVE_YW", "CURVE_WW",
    "SLIDE_ALONG", "RATE_ALONG", "SLIDE_ACROSS", "RATE_ACROSS", "KINK_1", "KINK_2", "KINK_3",
    "KINK_4", "SLOPE", "BOUND_START", "BOUND_SLOPE", "BOUND_SIDE", "KINKS",
)  # fmt: skip
ROWS_OF_MARKS = ("ROTOR", "SUPPORT", "SPAN_ROW", "SPAN_FIRST", "SPAN_LAST", "COUNTS")
KINKS_A_CONTACT = 4
OUTLINE = 1.01  # by which an outline is drawn too large, for safety


def layout(capacity: int) -> MappingProxyType[str, int]:
    """The constants of `dynamics.types` for scratch with room for so many contacts, by name."""
    places = {name: getattr(types, name) // types.STRIDE * capacity for name in ROWS_OF_TABLE}
    marks = {name: getattr(types, name) // types.STRIDE * capacity for name in ROWS_OF_MARKS}
    counts = marks["COUNTS"]
    return MappingProxyType(
        {
            "CAPACITY": capacity,
            "STRIDE": capacity,
            **places,
            "TABLE_SIZE": places["KINKS"] + KINKS_A_CONTACT * capacity,
            **marks,
            "SPANS": counts + types.SPANS - types.COUNTS,
            "SUPPORTS": counts + types.SUPPORTS - types.COUNTS,
            "MARKS_SIZE": counts + types.MARKS_SIZE - types.COUNTS,
        }
    )


def capacity_of(settings: Settings) -> int:
    """Room for the contacts and the edges of every parcel that an environment's task draws."""
    parcels = settings.chosen_task.parcels
    return capacity_for([parcel.base for parcel in parcels], settings.chosen_plant)


def capacity_for(bases: Sequence[Base], plant: Plant) -> int:
    """Room for the contacts and the edges of any of some bases on a plant."""
    pitches = (plant.geometry.pitch_x, plant.geometry.pitch_y)
    contacts = [most_contacts(base, pitches) for base in bases]
    return max(FEWEST_EDGES, *contacts, *(len(base.edges) for base in bases))


def most_contacts(base: Base, pitches: tuple[float, float]) -> int:
    """The most elements that a base covers, however it lies.

    A convex figure of area A and perimeter P covers at most A + P / 2 + 1 points of the unit
    lattice (Nosarzewska, Evaluation de la difference entre l'aire d'une region plane convexe et le
    nombre des points aux coordonnees entieres couverts par elle, 1948).

    Args:
        base: of a parcel.
        pitches: [m] between elements, in x and in y.
    """
    corners = OUTLINE * base.outline  # a round base's outline is a polygon within it
    following = np.roll(corners, -1, axis=0)
    area = 0.5 * np.sum(corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0])
    perimeter = np.hypot(*(following - corners).T).sum()
    return math.ceil(area / math.prod(pitches) + 0.5 * perimeter / min(pitches) + 1.0)
