"""Common ground of all agents: the controller's interface, axis angles, zones, command lines."""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from surface_gym.lines import Line

FLOW_TASK = "flow"  # the task of streams of parcels

# A file of the checkout, or the command of the installed package.
_IN_CHECKOUT = (Path(__file__).parents[1] / "train.py").is_file()
TRAIN = ("python", "train.py") if _IN_CHECKOUT else ("surface-gym", "train")
EVALUATE = ("python", "evaluate.py") if _IN_CHECKOUT else ("surface-gym", "evaluate")

SAME = 1e-6  # [rad] axes closer than this are one


class Controller(Protocol):
    """Chooses actions from observations, as Stable-Baselines3's models do."""

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Choose an action for an observation (features,), or actions for (num_envs, features).

        Args:
            observation: of one environment or of several.
            state: returned by the last call; None at first, and always without memory.
            episode_start: (num_envs,) whether an episode has just begun; None only if `state` is.
            deterministic: choose the best action, or draw one.

        Returns:
            The actions, and the state for the next call.
        """


def command_line(program: Sequence[str], *arguments: str) -> str:
    """Join a program, such as `TRAIN`, and its arguments into a line for a shell."""
    return shlex.join([*program, *arguments])


def axes_apart(one: ArrayLike, other: ArrayLike) -> NDArray[np.float64]:
    """Compute the difference, 0 to pi / 2, of axis angles [rad]; an axis turned by pi is the same.

    The angles broadcast.
    """
    turned = np.exp(2j * (np.asarray(one) - np.asarray(other)))
    apart: NDArray[np.float64] = np.abs(np.angle(turned)) / 2.0
    return apart


def with_zone(line: "Line", columns: int) -> "Line":
    """Return a line with a zone of so many columns and the same lengths before and behind it."""
    longer = columns - line.zone_columns
    return replace(line, columns=line.columns + longer, zone_columns=columns)


def time_for(line: "Line", columns: int) -> float:
    """Compute the factor [-] on an episode's time limit for a zone of so many columns."""
    return max(1.0, columns / line.zone_columns)
