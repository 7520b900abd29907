"""A batch of lanes: starts are placed on it, commands move it."""

import math

import numpy as np
from numba import config, get_num_threads, set_num_threads

from surface_gym.actuators import Actuators
from surface_gym.batch.commands import CONVEYOR, Acting
from surface_gym.batch.period import Rules, advance_lanes, advance_lanes_on_threads, begin_lanes
from surface_gym.batch.placement import NO_EDGE, Placement, placement_of
from surface_gym.dynamics.types import GRAVITY, Array
from surface_gym.lanes.memory import (
    NOISE_ROWS,
    RUNNING,
    Booleans,
    Integers,
    Lanes,
    Sizes,
    Timing,
    make_batch_scratch,
    make_lanes,
)
from surface_gym.parcel import Parcel
from surface_gym.plant import GEOMETRY
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Sensors
from surface_gym.surface import Surface
from surface_gym.tasks.task import Start, Task

_FEWEST_EDGES = 4
_FEWEST_CONTACTS = 64


def _state_of(start: Start) -> tuple[float, ...]:
    """State vector of the centre of mass."""
    x, y, theta = start.pose
    vx, vy, omega = start.velocity
    com_x, com_y = start.parcel.centre_of_mass
    if (com_x, com_y) == (0.0, 0.0):
        return (x, y, theta, vx, vy, omega, 0.0, 0.0)
    cosine, sine = math.cos(theta), math.sin(theta)
    arm_x, arm_y = cosine * com_x - sine * com_y, sine * com_x + cosine * com_y
    return (x + arm_x, y + arm_y, theta, vx - omega * arm_y, vy + omega * arm_x, omega, 0.0, 0.0)


class Batch:
    """Lanes of one task, one kind of action and one control period.

    Args:
        task: what is asked.
        acting: how commands turn axes.
        command_size: numbers in a command.
        window_size: numbers that a window adds to the observation.
        lanes: their number.
        timing: how a control period is cut into steps.
        zone: first and last column that obey; None for the plant's own.
        sensors: what a controller gets to see.
        actuators: which modules are stuck.
        randomisation: what differs from start to start.
        threads: that share the lanes; results do not depend on their number.
    """

    def __init__(
        self,
        task: Task,
        acting: Acting,
        command_size: int,
        window_size: int,
        lanes: int,
        timing: Timing,
        zone: tuple[int, int] | None,
        sensors: Sensors,
        actuators: Actuators,
        randomisation: Randomisation,
        threads: int,
    ) -> None:
        self.task = task
        self._zone = zone
        self._actuators = actuators
        self._randomisation = randomisation
        self._varies = randomisation.varies
        self.rules = Rules(
            task.number, len(task.features), GEOMETRY, timing, acting, sensors.sensing(timing.dt)
        )
        self._draws = sensors.draws(timing.dt, timing.steps)
        sizes = Sizes(
            lanes=lanes,
            rows=task.plant.rows,
            columns=task.plant.columns,
            edges=_FEWEST_EDGES,
            command=command_size,
            observation=len(task.features) + window_size,
            terms=len(task.terms),
            turning=acting.turn != math.inf,
        )
        self.lanes: Lanes = make_lanes(sizes)
        self._contacts = _FEWEST_CONTACTS
        self._scratch = make_batch_scratch(threads, _FEWEST_CONTACTS, _FEWEST_EDGES)
        self._tilts: list[float | None] = [None] * lanes
        self._parcels: list[Parcel | None] = [None] * lanes
        self._generators: list[np.random.Generator | None] = [None] * lanes
        nominal = Surface(axis=np.zeros((1, 1)), rotor=np.ones((1, 1), dtype=bool))
        self._friction = (nominal.mu_max, nominal.mu_min, nominal.mu_support)

    def place(self, lane: int, start: Start, generator: np.random.Generator) -> None:
        """Put a start on a lane, every axis at 90 deg as the conveyor's; then `begin` it.

        The randomisation, the stuck modules and the sensors' noise are drawn from the generator,
        in that order.
        """
        shape = (self.task.plant.rows, self.task.plant.columns)
        friction, stiffness = (1.0, 1.0, 1.0), None
        if self._varies:
            start, friction, stiffness = self._randomisation.draw(generator, start, shape)
        if self._parcels[lane] is not start.parcel:
            self._place_parcel(lane, start.parcel)
        lanes = self.lanes
        lanes.state[lane] = _state_of(start)
        if self._varies or self._tilts[lane] != start.tilt:
            lanes.surface[lane] = (
                self._friction[0] * friction[0],
                self._friction[1] * friction[1],
                self._friction[2] * friction[2],
                GRAVITY * math.sin(start.tilt),
                GRAVITY * math.cos(start.tilt),
            )
            self._tilts[lane] = start.tilt
        lanes.goal[lane, : len(start.goal)] = start.goal
        if start.path is not None:
            lanes.path[lane] = start.path
        if stiffness is not None:
            lanes.stiffness[lane] = stiffness
        if self._actuators.stuck_share:
            working = generator.random(shape) >= self._actuators.stuck_share
            lanes.obeys[lane] = self._obeys(start.parcel) & working
        self._generators[lane] = generator
        if self._draws:
            self._draw_noise(lane)

    def _place_parcel(self, lane: int, parcel: Parcel) -> None:
        """Write what follows from the parcel and the plant, which the next start may share."""
        placement = placement_of(parcel, self.task.plant, self._zone)
        self._make_room(placement)
        lanes = self.lanes
        lanes.axis[lane] = CONVEYOR
        lanes.rotor[lane] = placement.rotor
        lanes.obeys[lane] = self._obeys(parcel)
        lanes.body[lane] = placement.body
        lanes.edges[lane] = NO_EDGE
        lanes.edges[lane, : len(placement.edges)] = placement.edges
        lanes.corners[lane] = placement.corners[0]
        lanes.corners[lane, : len(placement.corners)] = placement.corners
        lanes.zone[lane] = placement.zone
        self._parcels[lane] = parcel

    def _obeys(self, parcel: Parcel) -> Booleans:
        """(rows, columns) rotors that obey, those known to be stuck left out."""
        obeys = placement_of(parcel, self.task.plant, self._zone).obeys.copy()
        for row, column in self._actuators.stuck:
            obeys[row, column] = False
        return obeys

    def check(self, parcel: Parcel) -> None:
        """Raise what `place` would: a parcel that does not fit the plant is a ValueError."""
        placement_of(parcel, self.task.plant, self._zone)

    def begin(self, chosen: Integers) -> None:
        """Sense and observe the chosen lanes (count,), on which starts were placed."""
        begin_lanes(self.rules, self.lanes, chosen)

    def advance(self, commands: Integers) -> None:
        """Move every lane that has not ended over one control period."""
        self.lanes.command[:] = commands
        if self._draws:
            # Not for a lane that has ended: its next start must find the generator as a single
            # env would.
            short = self.lanes.noise_row + self._draws > NOISE_ROWS
            for lane in np.nonzero(short & (self.lanes.outcome == RUNNING))[0].tolist():
                self._draw_noise(lane)
        threads = self._scratch.normal.shape[0]
        if threads == 1:
            advance_lanes(self.rules, self.lanes, self._scratch)
            return
        # Only as many threads as there is work for: the others would spin at its end.
        others = get_num_threads()
        set_num_threads(min(threads, config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
        advance_lanes_on_threads(*self.rules, self.lanes, self._scratch)
        set_num_threads(others)

    def _draw_noise(self, lane: int) -> None:
        """Three standard normals and a uniform a row."""
        generator = self._generators[lane]
        assert generator is not None
        noise = self.lanes.noise[lane]
        noise[:, :3] = generator.standard_normal((NOISE_ROWS, 3))
        noise[:, 3] = generator.random(NOISE_ROWS)
        self.lanes.noise_row[lane] = 0

    def _make_room(self, placement: Placement) -> None:
        """Widen the memory for a base of more edges or contacts than any before it."""
        old = self.lanes
        have = old.edges.shape[1]
        edges = max(have, len(placement.edges), len(placement.corners))
        contacts = max(self._contacts, placement.contacts)
        if edges > have:
            more: Array = np.tile(NO_EDGE, (len(old.clock), edges - have, 1))
            repeats = np.repeat(old.corners[:, :1], edges - have, axis=1)
            self.lanes = old._replace(
                edges=np.concatenate([old.edges, more], axis=1),
                corners=np.concatenate([old.corners, repeats], axis=1),
            )
        if edges > have or contacts > self._contacts:
            threads = self._scratch.normal.shape[0]
            self._scratch = make_batch_scratch(threads, contacts, edges)
            self._contacts = contacts
