"""The best layouts that could be arranged beforehand: searched for each start by the simulator.

They know what the sensors say of the parcel at the start, the goal and the physics at nominal
friction; not the noise, nor which modules are stuck.
"""

import numpy as np
from numpy.typing import NDArray

from surface_gym.settings import Settings
from surface_gym.tasks.base import Start

from ..planning.layouts import LayoutModel
from ..planning.line_layouts import LAYOUTS, SEARCHES, best_line_layout
from ..planning.path_layouts import best_path_layout, path_model
from ..planning.shown_path import ShownPath, shown_start
from ..planning.start import start_of
from .axes import Axes, axes_of
from .fixed_braking import FixedSlowing, FixedStopping
from .fixed_turning import FixedTurning
from .lane_rule import Commands, FixedRule, Observations


class _Searched(FixedRule):
    """Layouts that are searched for each start."""

    _search: "_LineSearch"

    def _layout(self, observations: Observations) -> Commands:
        return self._search(observations)


class BestSlowing(_Searched, FixedSlowing):
    """Each module of the zone at 0, 45, -45 or 90 deg, so that the parcel should leave at the asked
    ratio; at least as near to it as with any layout of `FixedSlowing`.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._search = _LineSearch(settings, self._layouts)


class BestStopping(_Searched, FixedStopping):
    """Each module of the zone at 0, 45, -45 or 90 deg, so that the parcel should rest at the asked
    x; at least as near to it as with any layout of `FixedStopping`.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._search = _LineSearch(settings, self._layouts)


class BestTurning(_Searched, FixedTurning):
    """Each module of the zone at 0, 45, -45 or 90 deg, so that the parcel should leave at the asked
    angle; at least as near to it as with any layout of `FixedTurning`.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._search = _LineSearch(settings, self._to_left)


class BestTracking(FixedRule):
    """Two axes a column of the field, one left and one right of the path, so that the parcel should
    follow it at the asked speed.

    Raises:
        ValueError: the task does not show its path, besides what `FixedRule` raises.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("track",), ("modules",))
        if not isinstance(settings.task, ShownPath):
            raise ValueError(f"task must be a ShownPath, got {settings.task!r}")
        if settings.zone is not None:
            raise ValueError(f"zone must be None, the whole field, got {settings.zone!r}")
        self._model = path_model(settings)
        self._axes = axes_of(settings)

    def _layout(self, observations: Observations) -> Commands:
        return np.stack([self._of(seen) for seen in observations]).reshape(len(observations), -1)

    def _of(self, seen: NDArray[np.float32]) -> Commands:
        """Choices (rows, columns)."""
        start = shown_start(self._settings, seen)
        assert start.path is not None
        aside = start.path - start.path[0]
        away = aside[np.argmax(np.abs(aside) > 1e-6)]
        if away >= 0.0:
            return self._best(start)
        image = _mirrored(start, 2.0 * self._settings.chosen_plant.line_y)
        return _image(self._best(image), self._axes)

    def _best(self, start: Start) -> Commands:
        limit = self._settings.chosen_task.periods * self._settings.control_period
        return best_path_layout(self._model, self._axes, start, limit)


class _LineSearch:
    """A search for each start of a line.

    Args:
        settings: of the environment.
        known: (layouts, modules) to begin with, for goals to the left.
    """

    def __init__(self, settings: Settings, known: Commands) -> None:
        kind = settings.action_kind
        self._settings = settings
        self._axes = axes_of(settings)
        self._known = known.reshape(len(known), *kind.shape)
        self._model = LayoutModel(settings, max(LAYOUTS, len(known)))

    def __call__(self, observations: Observations) -> Commands:
        """Commands (lanes, modules) for episodes that have just begun."""
        return np.stack([self._of(seen) for seen in observations]).reshape(len(observations), -1)

    def _of(self, seen: NDArray[np.float32]) -> Commands:
        """Choices (rows, columns)."""
        start = start_of(self._settings, seen)
        turn = self._settings.task_name == "orient" and float(np.asarray(start.goal[0])) < 0.0
        if not turn:
            return self._best(start)
        image = _mirrored(start, 2.0 * self._settings.chosen_plant.line_y)
        (angle,) = start.goal
        return _image(self._best(image._replace(goal=(-np.asarray(angle),))), self._axes)

    def _best(self, start: Start) -> Commands:
        self._model.begin(start)
        search = SEARCHES[self._settings.task_name]
        return best_line_layout(self._model, search, self._axes, self._known)


def _mirrored(start: Start, across: float) -> Start:
    """A start as a mirror in the line's middle shows it, its goal but for the path as it is.

    Args:
        start: one.
        across: [m] twice the y of the line's middle.
    """
    x, y, theta = start.pose
    vx, vy, omega = start.velocity
    return start._replace(
        pose=(x, across - np.asarray(y), -np.asarray(theta)),
        velocity=(vx, -np.asarray(vy), -np.asarray(omega)),
        path=None if start.path is None else across - start.path,
    )


def _image(layout: Commands, axes: Axes) -> Commands:
    """Choices (rows, columns) as a mirror shows them."""
    flipped = layout[::-1]
    return np.select(
        [flipped == axes.left, flipped == axes.right], [axes.right, axes.left], flipped
    )
