"""What every task has in common."""

from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from surface_gym import checks
from surface_gym.dynamics.compiled import lane_function
from surface_gym.lanes.lane import Lane
from surface_gym.lanes.memory import FIRST_FAILURE
from surface_gym.plants import Line, Plant
from surface_gym.tasks.start import Draw, Start, parcels_to_draw


@dataclass(frozen=True)
class Feature:
    """One number of an observation."""

    name: str
    low: float  # [-] it cannot be below
    high: float  # [-] it cannot be above
    meaning: str  # with the unit it is scaled by


def failures(outcomes: tuple[str, ...]) -> range:
    """Numbers of a task's failures, in the order of their names, for `judge` to return."""
    return range(FIRST_FAILURE, FIRST_FAILURE + len(outcomes))


@dataclass(frozen=True)
class Task:
    """What is asked of the surface: starts, observation, reward, and when an episode ends.

    A task is one class. Its fields are its parameters. The names below say what it deals in; its
    static methods, each a `lane_function`, are compiled into every batch of it. A subclass inherits
    what it does not replace.

    The compiled functions read and write a `Lane`:

    - `begin(lane)`, at a start: set `lane.memory` and `lane.figures`.
    - `over(lane) -> bool`, after every physics step: whether the episode ends in the middle of a
      control period. By default where no rotor bears the parcel.
    - `judge(lane) -> int`, after a control period: RUNNING, SUCCESS or one of the failures. Writes
      `lane.figures`.
    - `reward(lane, outcome)`, then: write every one of `lane.terms`.
    - `observe(lane)`, at a start and after every control period: write every feature into
      `lane.observation`, from `lane.sensed`.
    - `mirror(lane) -> float`: -1 where the observation is mirrored in y, so that what shows the
      modules is mirrored with it; else 1.

    They know nothing of the task's fields: what they need of these goes into the goal.

    Raises:
        ValueError: no features, terms or outcomes, or parcels that are none.
    """

    parcels: Any = field(default=("S", "B"), kw_only=True)  # to draw from

    plant: ClassVar[Plant] = Line()
    features: ClassVar[tuple[Feature, ...]]
    terms: ClassVar[tuple[str, ...]]  # of the reward, in the order of `lane.terms`
    outcomes: ClassVar[tuple[str, ...]]  # how it may fail
    figures: ClassVar[tuple[str, ...]] = ()  # numbers in `info`, in the order of `lane.figures`
    options: ClassVar[tuple[str, ...]] = ()  # what `reset(options=...)` may fix
    draws: ClassVar[int] = 0  # uniform numbers that a start is made of
    goals: ClassVar[int] = 0  # numbers of `lane.goal`
    memories: ClassVar[int] = 0  # numbers of `lane.memory`
    has_path: ClassVar[bool] = False  # whether its starts come with a path
    leaves_zone: ClassVar[bool] = False  # whether its end is that the parcel's rear leaves the zone
    periods: ClassVar[int] = 100  # control periods after which an episode is truncated

    def __post_init__(self) -> None:
        for name in ("features", "terms", "outcomes"):
            if not isinstance(getattr(self, name, None), tuple):
                raise ValueError(
                    f"{type(self).__name__}.{name} must be a tuple, as Task says, "
                    f"got {getattr(self, name, None)!r}"
                )
        object.__setattr__(self, "parcels", parcels_to_draw(self.parcels))

    @property
    def name(self) -> str:
        """The task's name, whatever its parameters."""
        return type(self).__name__.lower()

    def start(self, draw: Draw) -> Start:
        """The law of its starts, for as many as `draw` has numbers for."""
        del draw
        raise ValueError(f"{type(self).__name__}.start must be a method, as Task says, got none")

    def readings(self, lane: Lane) -> list[tuple[str, str]]:
        """The task's own numbers of a lane, as pairs of texts, for drawing."""
        del lane
        return []

    def goal(self, lane: Lane) -> Any:
        """What drawing shows of a lane's goal, one of `surface_gym.rendering`'s; or None."""
        del lane

    @staticmethod
    @lane_function
    def begin(lane: Lane) -> None:
        """Nothing to remember."""

    @staticmethod
    @lane_function
    def over(lane: Lane) -> bool:
        """Where no rotor bears the parcel."""
        return not lane.on_rotors

    @staticmethod
    @lane_function
    def mirror(lane: Lane) -> float:
        """As it is."""
        return 1.0


def draws_default_parcels(task: Task) -> bool:
    """Whether a task draws the parcels that its class has it draw."""
    default = next(each.default for each in fields(task) if each.name == "parcels")
    return bool(task.parcels == parcels_to_draw(default))


def rising(name: str, value: Any, low: float, high: float) -> tuple[float, float]:
    """Two finite numbers in [low, high], the first not above the second, or an error."""
    first, last = checks.array(name, value, (2,)).tolist()
    if not low <= first <= last <= high:
        raise ValueError(
            f"{name} must be two rising numbers between {low:g} and {high:g}, got {value!r}"
        )
    return first, last
