"""Sort by the best layout whose axes may stand at any angle, found by search beforehand."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.core.actions import ANY
from surface_gym.design.sorting_layouts import sorting_layouts
from surface_gym.layouts import ROLLING
from surface_gym.settings import Settings

from ..sight import line_sight
from .best_sorting import BoxLayouts
from .lane_rule import Numbers, Observations


class GradedLayout:
    """One layout for all entry speeds, whose axes turn little by little from column to column: the
    one that `surface_gym.design` found for the study's box that is nearer in size.

    Straight through, the axes stay at 90 deg.

    Args:
        settings: of the environment it is to act in, with "modules" for actions and "any" for
            orientations.

    Raises:
        ValueError: another task, kind of action or orientations.
    """

    def __init__(self, settings: Settings) -> None:
        checks.one_of("task", settings.task_name, ("sort",))
        checks.one_of("actions", settings.actions, ("modules",))
        checks.one_of("orientations", settings.orientations, (ANY,))
        self._settings = settings
        chosen = [layout for layout in sorting_layouts() if layout.offer == "any"]
        self._layouts = BoxLayouts(chosen, settings.action_kind.shape)

    def predict(
        self,
        observation: Observations,
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:
        """Angles [rad] for an observation (features,), or for (lanes, features); and no state.

        See `agents.controller.Controller`; a layout knows no chance, whatever `deterministic`.
        """
        del state, episode_start, deterministic
        see = line_sight(self._settings, np.atleast_2d(observation))
        box = self._layouts.nearest(see.half_length)
        side = see.side[:, np.newaxis]
        angles: Numbers = np.select(
            [side > 0.0, side < 0.0],
            [self._layouts.to_side(1)[box], self._layouts.to_side(-1)[box]],
            ROLLING,
        )
        return (angles[0] if np.ndim(observation) == 1 else angles), None
