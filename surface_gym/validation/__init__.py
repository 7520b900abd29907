"""Validation of the physics by the simulator MuJoCo, in place of the paper's simulator Adams.

`build` and `simulate` take surfaces and parcels of `surface_gym`, so they can check any layout.
`python -m surface_gym.validation` repeats the comparison in the paper's Section 6.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surface_gym.validation.simulation import MujocoScene, Recipe, build, reachable, simulate

__all__ = ["MujocoScene", "Recipe", "build", "reachable", "simulate"]


def __getattr__(name: str) -> Any:
    """Import a name on first use, so that the command's `--help` is fast."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from surface_gym.validation import simulation

    return getattr(simulation, name)
