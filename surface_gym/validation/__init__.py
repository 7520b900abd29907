"""A second opinion on the physics: Section 6 of the paper with MuJoCo in the place of Adams.

`build` and `simulate` take the surfaces and parcels of `surface_gym`, so that any layout can be
checked; `python -m surface_gym.validation` repeats the paper's comparison.
"""

from surface_gym.validation.simulation import Recipe, Scene, build, reachable, simulate

__all__ = ["Recipe", "Scene", "build", "reachable", "simulate"]
