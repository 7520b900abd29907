"""Answers to the question which surface a parcel needs.

Functions take a `Case`, and may be given `columns` of the zone (None: the fewest that all but 5 %
of the draws need), `rows` of rotors (None: as many as lie under the parcel), `workers`, threads
that share the runs, or a cluster, and `on_progress`, called with the runs done and their total.

A name is imported from its module when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surface_gym.design.case import Case, Purpose, Slow, Sort, Stop, Turn, Unknown
    from surface_gym.design.columns import Columns, columns_by_rows, columns_by_speed, least_columns
    from surface_gym.design.fixed_layout import BestLayout, EveryLayout, best_layout, every_layout
    from surface_gym.design.limits import (
        FrictionRange,
        Limits,
        Span,
        friction_range,
        least_speed,
        least_tilt,
    )
    from surface_gym.design.runs import DesignLine, line_for

__all__ = [
    "BestLayout", "Case", "Columns", "DesignLine", "EveryLayout", "FrictionRange",
    "Limits", "Purpose", "Slow", "Sort", "Span", "Stop", "Turn",
    "Unknown", "best_layout", "columns_by_rows", "columns_by_speed", "every_layout",
    "friction_range", "least_columns", "least_speed", "least_tilt", "line_for",
]  # fmt: skip
_MODULES = ("case", "columns", "fixed_layout", "limits", "runs")


def __getattr__(name: str) -> Any:
    for module in _MODULES if name in __all__ else ():
        found = getattr(import_module(f"{__name__}.{module}"), name, None)
        if found is not None:
            globals()[name] = found
            return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
