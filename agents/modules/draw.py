"""Draws that modules share, so that what they try does not average out under the parcel.

A parcel rests on 6 to 25 modules. Where each draws its axis by itself, their deviations cancel and
none is ever seen to pay. Here the modules of a group look up one uniform number in their own
cumulative probabilities: alike modules choose alike, and each still follows its own probabilities.
The choices of a group then have a likelihood in closed form: the uniforms that lead to just these
choices make an interval, and its length is the likelihood.
"""

import numpy as np
import torch

from .view import Integers, Singles

GROUPS = 2  # a lane
_LEAST = 1e-6  # length below which an interval counts as empty: single precision ends there
_FARTHEST = 0.7  # half lengths from the parcel's centre that a line between groups may pass


def draw_groups(
    lane: Integers, place: Singles, lanes: int, parted: float, rng: np.random.Generator
) -> Integers:
    """Group of each module (modules,), GROUPS a lane: those of lane i are GROUPS i and the next.

    Args:
        lane: (modules,) each module's.
        place: (modules, ...) its place along and across the parcel, in half lengths, comes first.
        lanes: their number.
        parted: probability that a line at random through the parcel parts its modules.
        rng: draws three numbers a lane.
    """
    parts = rng.random(lanes) < parted
    angle = 2.0 * np.pi * rng.random(lanes)
    passes = rng.uniform(-_FARTHEST, _FARTHEST, lanes)
    across = np.cos(angle)[lane] * place[:, 0] + np.sin(angle)[lane] * place[:, 1]
    return GROUPS * lane + (parts[lane] & (across > passes[lane]))


def draw_choices(
    log_probability: torch.Tensor, group: torch.Tensor, uniform: torch.Tensor
) -> torch.Tensor:
    """Choices (modules,) at each group's uniform.

    Args:
        log_probability: (modules, choices).
        group: (modules,) each module's.
        uniform: (groups,) in [0, 1).
    """
    edges = log_probability.exp().cumsum(dim=1)[:, :-1]
    return (uniform[group].unsqueeze(1) > edges).sum(dim=1)


def log_likelihood(
    log_probability: torch.Tensor, choice: torch.Tensor, group: torch.Tensor, groups: int
) -> torch.Tensor:
    """(lanes,) of the choices (modules,) of all modules of a lane together, given the groups.

    It is 0 for a lane without modules. Where no uniform leads to the choices any more, it is as
    low as it gets and has no gradient.
    """
    edges = log_probability.exp().cumsum(dim=1)[:, :-1]
    below = torch.nn.functional.pad(edges, (1, 0), value=0.0).gather(1, choice.unsqueeze(1))
    above = torch.nn.functional.pad(edges, (0, 1), value=1.0).gather(1, choice.unsqueeze(1))
    first = below.new_zeros(groups).scatter_reduce(0, group, below.squeeze(1), "amax")
    last = above.new_ones(groups).scatter_reduce(0, group, above.squeeze(1), "amin")
    return (last - first).clamp(min=_LEAST).log().reshape(-1, GROUPS).sum(dim=1)
