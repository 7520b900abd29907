"""Confidence intervals of success rates and of means."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

CONFIDENCE = 0.95


def interval(success: NDArray[np.bool_]) -> tuple[float, float]:
    """Compute the 95 % interval of a success rate over seeds and starts.

    Wilson's interval, at the number of independent starts that would spread the mean as the seeds
    and the starts together do: a seed that fails everywhere must not count as many starts.

    Args:
        success: (seeds, starts) the same starts for every seed.
    """
    seeds, starts = success.shape
    share = float(success.mean())
    spread = _variance_of_mean(success.mean(axis=0))
    if seeds > 1:
        spread += _variance_of_mean(success.mean(axis=1))
    count = share * (1.0 - share) / spread if spread > 0.0 else float(starts)
    return wilson(share, min(count, float(success.size)))


def wilson(share: float, count: float) -> tuple[float, float]:
    """Compute Wilson's score interval of a share of `count` trials, which need not be whole."""
    z = float(norm.ppf(0.5 + CONFIDENCE / 2.0))
    centre = (share + z * z / (2.0 * count)) / (1.0 + z * z / count)
    half = z * np.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count**2))
    half /= 1.0 + z * z / count
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def half_interval(values: NDArray[np.float64]) -> float:
    """Compute half of Student's 95 % interval of a mean of independent values, at least two."""
    count = len(values)
    spread = float(values.std(ddof=1)) / math.sqrt(count)
    return float(student.ppf(0.5 + CONFIDENCE / 2.0, count - 1)) * spread


def _variance_of_mean(values: NDArray[np.float64]) -> float:
    return float(values.var(ddof=1)) / len(values) if len(values) > 1 else 0.0
