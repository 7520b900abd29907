"""What a flow's environment is made with, checked once for all its faces."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces

from surface_gym import checks
from surface_gym.core.actions import ANY, ActionKind
from surface_gym.flow.actions import FlowActions
from surface_gym.flow.exits import exits_option
from surface_gym.flow.features import FEATURES
from surface_gym.flow.line import flow_line
from surface_gym.flow.obeying import HALVES
from surface_gym.flow.stream import Stream
from surface_gym.lines import BaseLine
from surface_gym.physics.collision import ContactMaterial
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact, Sensor
from surface_gym.sensors.base import ENTRY_ROWS
from surface_gym.settings import check_kinds, check_stuck, timing_of
from surface_gym.state import NOISE_ROWS, Timing

ACTIONS = ("modules", "parcels")
MOST_PLACES = 256
LEVELLING = 0.01  # [rad] a slope that makes up for what rolling costs: tan(tilt) = mu_min
STEEPEST = math.radians(15.0)
DEFAULT_LINE = flow_line()


@dataclass(frozen=True)
class FlowSettings:
    """Arguments of a flow's environment.

    Raises:
        ValueError: an argument is not allowed, or a number is beyond `surface_gym.checks`; the
            message names it, what came and what may come.
    """

    stream: Stream = Stream()
    exits: Any = "chutes"  # a preset's name, or Exits of one's own
    actions: str = "modules"  # "modules", each its own; or "parcels", halves for each parcel
    sensors: Sensor = Exact()  # what a controller gets to see of each parcel
    control_period: float = 0.04  # [s] between decisions
    duration: float = 60.0  # [s] of an episode
    places: int = 24  # for parcels on the surface at a time
    plant: BaseLine | None = None  # None: `flow_line()`, 6 m with 4 rows of rotors
    tilt: float = LEVELLING  # [rad] downhill towards +x
    # [rad] axis angles on offer; None: the plant's; "any": an action says angles
    orientations: tuple[float, ...] | str | None = None
    actuators: Actuators = Actuators()
    randomisation: Randomisation = Randomisation()
    restitution: float = 0.0  # [-] of parcels' sides that touch
    side_friction: float = 0.3  # [-] between them
    gate: bool = False  # whether an action says when the next parcel may enter
    entry_gap: float = 0.02  # [m] clear ahead of a parcel that enters
    ahead: float = 0.1  # [s] in which a parcel must be about to bear on a module that obeys it
    patience: float = 2.0  # [s] without any motion that make a jam

    def __post_init__(self) -> None:
        check_kinds(
            self,
            (
                ("stream", Stream, "a Stream"),
                ("sensors", Sensor, "a Sensor"),
                ("actuators", Actuators, "Actuators"),
                ("randomisation", Randomisation, "a Randomisation"),
                ("plant", BaseLine | None, "a Plant"),
            ),
        )
        set_field = object.__setattr__
        checks.one_of("actions", self.actions, ACTIONS)
        if isinstance(self.orientations, str):
            checks.one_of("orientations", self.orientations, (ANY,))
        elif self.orientations is not None:
            set_field(self, "orientations", checks.orientations("orientations", self.orientations))
        for name, allowed in (
            ("control_period", checks.CONTROL_PERIOD),
            ("duration", (0.0, checks.EPISODE)),
            ("patience", checks.PATIENCE),
        ):
            set_field(self, name, checks.positive(name, getattr(self, name), *allowed))
        if self.duration < self.control_period:
            raise ValueError(
                f"duration must be at least a control period, {self.control_period:g} s, "
                f"got {self.duration!r}"
            )
        for name, most in (
            ("side_friction", checks.FRICTION),
            ("entry_gap", checks.LENGTH[1]),
            ("ahead", checks.AHEAD),
        ):
            set_field(self, name, checks.not_negative(name, getattr(self, name), most))
        set_field(self, "tilt", checks.within("tilt", self.tilt, -STEEPEST, STEEPEST))
        checks.one_of("gate", self.gate, (False, True))
        if self.gate and self.orientations == ANY:
            raise ValueError("gate must be False where orientations are 'any', got True")
        checks.within("restitution", self.restitution, 0.0, 1.0)
        if checks.integer("places", self.places, least=1) > MOST_PLACES:
            raise ValueError(f"places must be at most {MOST_PLACES}, got {self.places!r}")
        check_stuck(self.actuators, self.chosen_plant)
        self.randomisation.check_room(self.chosen_plant.width)
        if not self.rotor.any():
            raise ValueError("plant must have a rotor, got none")
        set_field(self, "exits", exits_option(self.exits, self.rotors_end - self.entry_x))
        self.check_stream(self.stream)
        _ = self.action_kind, self.draws

    def check_stream(self, stream: Stream) -> None:
        """Raise a ValueError where the exits or the surface do not do for a stream."""
        stream.check(self.exits)
        plant = self.chosen_plant
        for parcel in stream.kinds:
            largest = self.randomisation.largest(parcel.base)
            site = plant.site(largest)
            if (site.rotor != self.rotor).any() or site.zone != self.zone:
                raise ValueError(
                    f"plant must have the same rotors and zone for every parcel of the stream, "
                    f"as flow_line() has, got {type(plant).__name__}"
                )
            length, width = np.ptp(largest.outline, axis=0)
            if length > plant.length or width > plant.width:
                raise ValueError(
                    f"parcels must be at most as long and wide as the plant, {plant.length:g} m x "
                    f"{plant.width:g} m, got {length:g} m x {width:g} m"
                )
            # A smaller one would lie between rotors, as if it had left.
            least = self.randomisation.least(parcel.base)
            length, width = np.ptp(least.outline, axis=0)
            if length < plant.pitch_x or width < plant.pitch_y:
                raise ValueError(
                    f"parcels must be at least a pitch long and wide, {plant.pitch_x:g} m x "
                    f"{plant.pitch_y:g} m, got {length:g} m x {width:g} m"
                )

    @property
    def chosen_plant(self) -> BaseLine:
        """Where it happens."""
        return DEFAULT_LINE if self.plant is None else self.plant

    @cached_property
    def rotor(self) -> Any:
        """(rows, columns) whether there is a rotor; the same for every parcel."""
        return self.chosen_plant.site(self.stream.kinds[0].base).rotor

    @cached_property
    def zone(self) -> tuple[int, int, int, int]:
        """First row, rows, first column and columns that obey."""
        return self.chosen_plant.site(self.stream.kinds[0].base).zone

    @property
    def entry_x(self) -> float:
        """[m] edge of the line, where the rear of a parcel is as it enters."""
        return self.chosen_plant.column_edge(0)

    @property
    def rotors_end(self) -> float:
        """[m] x half a pitch past the last column with a rotor."""
        return self.chosen_plant.column_edge(int(np.nonzero(self.rotor.any(axis=0))[0][-1]) + 1)

    @property
    def chosen_orientations(self) -> tuple[float, ...]:
        """[rad] axis angles on offer; where any angle is, the plant's."""
        if self.orientations is None or isinstance(self.orientations, str):
            return self.chosen_plant.orientations
        return self.orientations

    @property
    def rows(self) -> int:
        """Of a surface's table: the places, and with a gate one for the parcel that waits there."""
        return self.places + (1 if self.gate else 0)

    @property
    def flow_actions(self) -> FlowActions:
        """What an action says."""
        return FlowActions(self.action_kind, 1 + self.timing.steps if self.gate else 0)

    @property
    def action_kind(self) -> ActionKind:
        """How an action says a choice for each part: a module, or a half of a parcel's."""
        choices = 0 if self.orientations == ANY else len(self.chosen_orientations)
        _, rows, _, columns = self.zone
        shape = (rows, columns) if self.actions == "modules" else (self.places, HALVES)
        return ActionKind("modules", choices, *shape)

    @property
    def timing(self) -> Timing:
        """The control period in equal physics steps of at most 5 ms."""
        return timing_of(self.control_period)

    @property
    def periods(self) -> int:
        """Control periods of an episode."""
        return math.ceil(self.duration / self.control_period - 1e-9)

    @property
    def draws(self) -> int:
        """Rows of noise that the sensor of a place uses at most in a control period: those of a
        start, and of frames.
        """
        draws = self.sensors.draws(self.timing.dt, self.timing.steps)
        if draws == 0:
            return 0
        if draws + ENTRY_ROWS > NOISE_ROWS:
            raise ValueError(
                f"sensors must use at most {NOISE_ROWS - ENTRY_ROWS} rows of noise in a control "
                f"period, got {draws}"
            )
        return draws + ENTRY_ROWS

    @property
    def sides(self) -> ContactMaterial:
        """How parcels' sides behave."""
        return ContactMaterial(float(self.restitution), self.side_friction)

    def row_space(self) -> spaces.Box:
        """The space of one row of the observation."""
        return spaces.Box(
            np.array([feature.low for feature in FEATURES], dtype=np.float32),
            np.array([feature.high for feature in FEATURES], dtype=np.float32),
        )

    def observation_space(self) -> spaces.Box:
        """The space of one surface's observation: a row a place, a column a feature."""
        row = self.row_space()
        return spaces.Box(np.tile(row.low, (self.rows, 1)), np.tile(row.high, (self.rows, 1)))

    def action_space(self) -> spaces.Space[Any]:
        """The space of one surface's action."""
        return self.flow_actions.space()
