"""Adams's displacements, as far as the study's printed errors give them away."""

import json
from dataclasses import dataclass
from decimal import Decimal
from importlib import resources

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Printed:
    """Adams's displacement without sign lies between these: printed errors are rounded."""

    low: NDArray[np.float64]  # (3,) [m, m, deg]
    high: NDArray[np.float64]  # (3,) [m, m, deg]


def printed(run: str) -> Printed:
    """Of the run "gamma10", 10 deg, or "v09", 0.9 m/s on the level.

    Section 6.2 prints the error |e| of each and |e %| = 100 |e| / |displacement by Adams|.
    """
    text = resources.files("surface_gym.paper").joinpath("data/targets.json").read_text("utf-8")
    numbers = json.loads(text)["validation"][run]
    errors, percents = np.abs(numbers["abs"]), np.abs(numbers["percent"])
    error_rounding, percent_rounding = _half_digits(errors), _half_digits(percents)
    return Printed(
        low=100.0 * (errors - error_rounding) / (percents + percent_rounding),
        high=100.0 * (errors + error_rounding) / (percents - percent_rounding),
    )


def _half_digits(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half a unit of the last digit that is printed."""
    digits = [Decimal(repr(value)).as_tuple().exponent for value in values.tolist()]
    return np.array([0.5 * 10.0 ** int(digit) for digit in digits])
