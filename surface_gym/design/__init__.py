"""Design of the surface that a parcel needs, after the study by Bianchi et al. (2023).

Functions take a `Case` and optional arguments. `columns` of the zone are by default the fewest that
succeed in 95 % of random draws of the unknown quantities. `rows` of rotors are by default as many
as fit under the parcel. `workers` is a number of threads, or a cluster. `on_progress` is called
with the finished and the total number of runs.

Names are imported from their modules on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surface_gym.design.case import (
        Case,
        Purpose,
        SlowPurpose,
        SortPurpose,
        StopPurpose,
        TurnPurpose,
        Unknown,
    )
    from surface_gym.design.columns import Columns, least_columns
    from surface_gym.design.fixed_layout import BestLayout, best_layout, every_layout
    from surface_gym.design.limits import (
        FrictionRange,
        Limits,
        Span,
        friction_range,
        least_speed,
        least_tilt,
    )
    from surface_gym.design.loads import ModuleLoads, module_loads
    from surface_gym.design.runs import DesignLine, line_for

__all__ = [
    "BestLayout", "Case", "Columns", "DesignLine", "FrictionRange", "Limits", "ModuleLoads",
    "Purpose", "SlowPurpose", "SortPurpose", "Span", "StopPurpose", "TurnPurpose", "Unknown",
    "best_layout", "every_layout", "friction_range", "least_columns", "least_speed", "least_tilt",
    "line_for", "module_loads",
]  # fmt: skip
_MODULES = ("case", "columns", "fixed_layout", "limits", "loads", "runs")


def __getattr__(name: str) -> Any:
    for module in _MODULES if name in __all__ else ():
        found = getattr(import_module(f"{__name__}.{module}"), name, None)
        if found is not None:
            globals()[name] = found
            return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
