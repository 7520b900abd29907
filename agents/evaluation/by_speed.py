"""Sorting by entry speed, as a table."""

import numpy as np

from .sorting import minimum_speed, share_sorted, slower_time, sorted_by_speed
from .summary import Summary
from .table import NOTHING, Table
from .trials import PARCELS, SORT_SPEEDS

SHOWN_SPEEDS = np.arange(3, 28, 2) / 10.0  # [m/s] rows, of the speeds compared


def speed_table(summaries: dict[str, Summary]) -> Table:
    """Time to sort by entry speed: a column a box and contender, each by name."""
    ordered = [(parcel, name) for parcel in PARCELS for name in summaries]
    header = ("entry speed [m/s]", *(f"{parcel}-box, {name}" for parcel, name in ordered))
    rows = [
        (f"{speed:.1f}", *(_cell(summaries[name], parcel, speed) for parcel, name in ordered))
        for speed in SHOWN_SPEEDS
    ]
    least = [minimum_speed(summaries[name], parcel) for parcel, name in ordered]
    shares = [share_sorted(summaries[name], parcel) for parcel, name in ordered]
    rows.append(("minimum [m/s]", *(NOTHING if np.isnan(v) else f"{v:.2f}" for v in least)))
    rows.append(("success", *(f"{share:.3f}" for share in shares)))
    told = (
        "time to sort [s], the slower of both sides and the slowest seed; minimum and success over "
        f"{len(SORT_SPEEDS)} speeds from {SORT_SPEEDS[0]:g} to {SORT_SPEEDS[-1]:g} m/s"
    )
    return Table("sorting by entry speed", told, header, tuple(rows))


def _cell(summary: Summary, parcel: str, speed: float) -> str:
    column = int(np.argmin(np.abs(SORT_SPEEDS - speed)))
    time = float(slower_time(summary, parcel)[:, column].max())
    if np.isfinite(time):
        return f"{time:.3f}"
    return "fails" if not sorted_by_speed(summary, parcel)[:, column].any() else "some seeds"
