"""How far MuJoCo's own step, contact stiffness and rotors move its result."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.validation.cases import PUSHED, Case, displacement
from surface_gym.validation.recipe import RECIPE, Recipe

CASES = (Case(5.0), Case(14.0), PUSHED)
AS_IS = "recipe"
VARIANTS = {
    AS_IS: RECIPE,
    "step / 2": RECIPE.finer(2.0),
    "step x 2": RECIPE.finer(0.5),
    "stiffness x 2": RECIPE.stiffer(2.0),
    "stiffness / 2": RECIPE.stiffer(0.5),
    "rotors / 1000": RECIPE.lighter_rotors(1000.0),
}
JOBS = tuple((case, recipe) for case in CASES for recipe in VARIANTS.values())


@dataclass(frozen=True, eq=False)
class Variant:
    """A case with the recipe changed."""

    case: Case
    change: str
    shift: NDArray[np.float64]  # (3,) [mm, mm, deg] from the end by the recipe as it is
    error: NDArray[np.float64]  # (3,) [mm, mm, deg] from the end by the implicit method


def end(job: tuple[Case, Recipe]) -> NDArray[np.float64]:
    """(3,) [m, m, deg] displacement of a job."""
    case, recipe = job
    return displacement(case.mujoco(recipe))


def variants(ends: Sequence[NDArray[np.float64]]) -> tuple[Variant, ...]:
    """The study, given the ends of JOBS."""
    unit = np.array([1e3, 1e3, 1.0])
    table = np.reshape(ends, (len(CASES), len(VARIANTS), 3))
    return tuple(
        Variant(case, change, unit * (end - rows[0]), unit * (end - displacement(case.analytic())))
        for case, rows in zip(CASES, table, strict=True)
        for change, end in zip(VARIANTS, rows, strict=True)
    )
