"""The line a flow runs on: rows of rotors amid supports, which take over where the rotors end."""

import numpy as np

from surface_gym import checks
from surface_gym.lines import Pattern

ROWS = 20  # of the whole surface
RUN_OUT = 6  # columns of supports after the last rotors, for parcels that go straight on
PITCH = 0.1  # [m]


def flow_line(length: float = 6.0, rotor_rows: int = 4, lead_in: int = 5) -> Pattern:
    """A line of rotors with supports beside it and after it.

    Args:
        length: [m] of the rotors along x.
        rotor_rows: rows of them, in the middle of 20.
        lead_in: columns that stay at 90 deg, as the conveyor's before them: as many as the longest
            parcel is long, 5 for the B-box.

    Raises:
        ValueError: a line shorter than its lead-in, or an odd number of rows or more than 12.
    """
    checks.integer("lead_in", lead_in, least=0, most=checks.ELEMENTS)
    columns = round(checks.positive("length", length, *checks.LENGTH) / PITCH)
    if columns <= lead_in:
        raise ValueError(
            f"length must be more than the lead-in's, {lead_in * PITCH:g} m, got {length!r}"
        )
    checks.integer("rotor_rows", rotor_rows, least=2)
    if rotor_rows % 2 or rotor_rows > 12:
        raise ValueError(f"rotor_rows must be even and at most 12, got {rotor_rows!r}")
    first = (ROWS - rotor_rows) // 2
    rotor = np.zeros((ROWS, columns + RUN_OUT), dtype=bool)
    rotor[first : first + rotor_rows, :columns] = True
    return Pattern(rotor=rotor, lead_in=lead_in)
