"""Rules by which each module decides for itself, from the parcel's error at its own place."""

from abc import abstractmethod
from dataclasses import dataclass

from surface_gym import checks
from surface_gym.settings import Settings

from ..sight import line_sight, path_sight
from . import aims
from .axes import axes_of
from .lane_rule import Booleans, Commands, LaneRule, Memory, Numbers, Observations
from .modules import Motion, Places, line_places, window_places

ACTIONS = {"sort": "modules", "orient": "modules", "track": "window"}


@dataclass(frozen=True, eq=False)
class Above:
    """The parcel's point above each module, or where it would be if the parcel were larger."""

    velocity: Numbers  # (lanes, modules, 2) [m/s] x and y
    error: Numbers  # (lanes, modules, 2) [m/s] the velocity that it should have, less that
    under: Booleans  # (lanes, modules) there is such a point


class LocalRule(LaneRule):
    """Every module, by the same rule and without its neighbours, from the error above it alone.

    Made for Sort and Orient with "modules", and for Track with "window".
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, tuple(ACTIONS))
        task = settings.task_name
        checks.one_of("actions", settings.actions, (ACTIONS[task],))
        self._task = task
        self._axes = axes_of(settings)

    @abstractmethod
    def _turn(
        self, above: Above, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        """Each module's choice (lanes, modules), and what to remember (lanes, ...)."""

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        return self._turn(self._look(observations), memory, fresh)

    def _look(self, observations: Observations) -> Above:
        places, motion, wanted = self._motions(observations)
        velocity = motion.over(places)
        return Above(velocity, wanted.over(places) - velocity, places.under)

    def _motions(self, observations: Observations) -> tuple[Places, Motion, Motion]:
        """Where the modules are, how the parcel moves, and how it should."""
        if self._task == "track":
            path = path_sight(self._settings, observations)
            vx, vy = path.velocity
            moves = Motion(vx, vy, path.omega)
            return window_places(path, self._kind), moves, aims.along_path(path)
        line = line_sight(self._settings, observations)
        wanted = aims.off_the_line(line) if self._task == "sort" else aims.turned(line)
        moves = Motion(line.vx, line.vy, line.omega)
        return line_places(line, self._kind), moves, wanted
