"""The state estimator: it computes a parcel's state and observation from the device's messages.

The estimator has two environments. `SEEN` is at the time of the latest frame: the physics moves it
from frame to frame with the turning axes, and the environment's filter corrects it. `NOW` is a copy
that the physics moves on to the time of the decision. So a late frame corrects the estimate at the
time of the frame, and later commands are applied again.

Physics, filter and observations are the package's own; functions at the file's end combine them.
"""

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import actions, checks, state as st
from surface_gym.compiler.jit import compile_for, compiled
from surface_gym.config import SURE, EnvConfig
from surface_gym.core.assembly import make_env_params, make_state, task_functions
from surface_gym.core.kernel import EnvParams, Function, KernelFunctions, obeying, showing
from surface_gym.core.resets import BodyPlan, Placement, place_parcel
from surface_gym.layouts import ROLLING
from surface_gym.machine.messages import MAX_LATE, Angles, Frame, ParcelEntry
from surface_gym.parcel import Parcel
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.step import axis_direction, split_gravity
from surface_gym.physics.types import Array, Integers, Scratch, make_scratch
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera, Exact, Sensor
from surface_gym.sensors.base import Physics
from surface_gym.sensors.camera import EVERY, LAG
from surface_gym.tasks.start import Parcels

SEEN, NOW = 0, 1  # indices of the environments
BOTH = np.array([SEEN, NOW])
MAX_COMMANDS = 256  # maximum number of commands since the latest frame: 10 s at 25 Hz
MIN_APART = 1e-6  # [s] minimum time between different frames
NOT_LOST = 1.0  # [-] uniform number at which no frame is dropped
NEVER = 2.0**40  # physics steps between frames, so that none is taken
IDEAL = Camera(latency=0.0, position_noise=0.0, angle_noise=0.0, entry=SURE)


def device_camera(sensor: Sensor) -> Camera:
    """Return the camera of an environment's sensor. For an exact sensor, return `IDEAL`."""
    if isinstance(sensor, Camera):
        return sensor
    if isinstance(sensor, Exact):
        return IDEAL
    raise ValueError(f"sensors must be a Camera or Exact, which has frames, got {sensor!r}")


def machine_axis_speed(config: EnvConfig) -> float:
    """Return the speed [rad/s] of a machine's axes.

    Raises:
        ValueError: the modules are driven. Machines report no speeds of drives.
    """
    if config.module_kind.drives:
        raise ValueError(f"modules must be idle in real time, got {config.modules!r}")
    return min(config.actuators.axis_speed, checks.AXIS_SPEED[1])


def within_right_angles(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move axes' angles (...) [rad] into -pi/2 to pi/2; an axis turned by pi is the same axis."""
    turned = angles - math.pi * np.floor(angles / math.pi + 0.5)
    return np.where(np.abs(angles) <= 0.5 * math.pi, angles, turned)


def zone_angles(whole: NDArray[np.float64], zone: Integers, shape: tuple[int, int]) -> Angles:
    """Return the angles (rows, columns) [rad] of the axes in a parcel's zone.

    Args:
        whole: (rows, columns) [rad] angles of the axes of the whole surface.
        zone: (4,) a parcel's zone, as in `BodyTable.zone`.
        shape: (rows, columns) of the widest zone. A narrower zone fills the middle rows; the other
            rows are at 90 deg.
    """
    angles = np.full(shape, ROLLING)
    rows, first_row, first = int(zone[st.ROWS]), int(zone[st.FIRST_ROW]), int(zone[st.FIRST_COLUMN])
    margin = (shape[0] - rows) // 2
    part = whole[first_row : first_row + rows, first : first + int(zone[st.COLUMNS])]
    angles[margin : margin + rows] = part
    return angles


@dataclass
class _Command:
    """A command that was sent to the device."""

    number: int
    at: float  # [s] start of the turn
    target: NDArray[np.float64]  # (rows, columns) [rad] of the whole surface


@dataclass(frozen=True, eq=False)
class Resolver:
    """Converts commands of one kind of action to angles of axes; see `Estimator.resolve`."""

    obey: Callable[..., None]  # compiled
    command: NDArray[Any]  # (environments, size) buffer


class Estimator(ABC):
    """Base class of estimators of the state at the latest picture (SEEN) and at present (NOW)."""

    _surfaces: st.SurfaceState
    _axis_speed: float  # [rad/s]
    config: EnvConfig  # the policy's environment as the estimator assumes it
    shape: tuple[int, int]  # (rows, columns) of the widest zone
    entered: Any  # None: there is no parcel to control

    def __init__(self) -> None:
        self._commands: deque[_Command] = deque(maxlen=MAX_COMMANDS)
        self._at = 0.0  # [s] time of the environment SEEN

    def note_sent(self, number: int, at: float) -> None:
        """Record that `resolve`'s latest result was sent as command `number` at time `at` [s]."""
        self._commands.append(_Command(number, at, self._surfaces.target[NOW].copy()))

    def acknowledge(self, number: int, at: float) -> None:
        """Record that the device began to execute command `number` at the time `at` [s]."""
        earliest = self._at
        for command in self._commands:
            if command.number == number:
                command.at = at
            earliest = command.at = max(earliest, command.at)

    def drop_command(self, number: int) -> None:
        kept = [each for each in self._commands if each.number != number]
        self._commands = deque(kept, maxlen=MAX_COMMANDS)

    def axes(self) -> Angles:
        """Return the zone's axis angles (rows, columns) [rad] at the latest observation's time."""
        return self._zone_angles(self._surfaces.angle[NOW])

    def longest_turn(self, angles: Angles) -> float:
        """Return the time [s] that the axes need to turn to angles (rows, columns) [rad]."""
        apart = angles - self.axes()
        apart -= math.pi * np.floor(apart / math.pi + 0.5)
        return float(np.abs(apart).max()) / self._axis_speed

    def _see(self, taken_at: float, looks: bool) -> bool:
        """Move SEEN to a picture's time [s]; return False if the picture is not newer than SEEN.

        If `looks` is true, the picture corrects the state.
        """
        if taken_at < self._at + MIN_APART:
            return False
        self._advance(SEEN, max(self._at, taken_at - MAX_LATE), taken_at, looks)
        self._at = taken_at
        while self._commands and self._commands[0].at < self._at:
            self._commands.popleft()
        return True

    def _advance(self, i: int, begun: float, until: float, looks: bool) -> None:
        """Move environment `i` from `begun` [s] to `until` [s], and apply commands in between.

        If `looks` is true, a picture at the time `until` corrects the state.
        """
        for command in self._commands:
            if command.at >= until:
                break
            self._move_on(i, begun, command.at, looks=False)
            begun = max(begun, command.at)
            self._surfaces.target[i] = command.target
        self._move_on(i, begun, until, looks)

    @abstractmethod
    def clear(self) -> None:
        """Forget all parcels."""

    @abstractmethod
    def depart(self, number: int) -> bool:
        """Forget the departed parcel `number`. Return whether only this parcel was controlled."""

    @abstractmethod
    def correct(self, picture: Any) -> bool:
        """Correct the estimate by a picture; return whether the picture was used."""

    @abstractmethod
    def observe(self, now: float) -> NDArray[np.float32]:
        """Return a copy of the task's observation at `now` [s]."""

    def resolver(self, kind: actions.ActionKind) -> Resolver:
        """Compile a `Resolver`, which converts commands of one kind of action to axis angles."""
        dtype = np.float64 if kind.continuous else np.int64
        command = np.zeros((len(BOTH), kind.size), dtype=dtype)
        return Resolver(compile_for(self._make_obey(kind), *self._arguments(command), NOW), command)

    def resolve(self, resolver: Resolver | None, command: NDArray[Any]) -> Angles:
        """Return the angles (rows, columns) [rad] to which a command (size,) turns the zone's axes.

        The command must be of the kind of action for which `resolver` was compiled. The angles
        depend on the parcels' positions in the latest result of `observe`.
        """
        assert resolver is not None
        resolver.command[NOW] = command
        resolver.obey(*self._arguments(resolver.command), NOW)
        return self._zone_angles(self._surfaces.target[NOW])

    @abstractmethod
    def _make_obey(self, kind: actions.ActionKind) -> Any:
        """Compile the function that sets the axes' targets from commands of the action `kind`."""

    @abstractmethod
    def _arguments(self, command: NDArray[Any]) -> tuple[Any, ...]:
        """Return the arrays of the environments SEEN and NOW.

        The arrays include `command` (environments, size).
        """

    @abstractmethod
    def _move_on(self, i: int, begun: float, until: float, looks: bool) -> None:
        """Move environment `i` to `until` [s]. If `looks` is true, a picture corrects the state."""

    @abstractmethod
    def _zone_angles(self, whole: NDArray[np.float64]) -> Angles:
        """Select the zone's angles (rows, columns) [rad] from the whole surface's angles."""


class StateEstimator(Estimator):
    """Estimator of one parcel's state, at the latest frame (SEEN) and at the decision (NOW).

    Raises:
        ValueError: the modules are driven, or the sensor is neither a Camera nor Exact.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__()
        self._axis_speed = machine_axis_speed(config)
        self.config = replace(
            config,
            sensors=device_camera(config.sensors),
            actuators=Actuators(axis_speed=self._axis_speed),
            randomisation=Randomisation(),
        )
        params = make_env_params(self.config)
        offered = within_right_angles(params.acting.orientations)
        self._params = params._replace(acting=params.acting._replace(orientations=offered))
        self._looks = make_looks(params.sensor)
        self._surfaces, self._parcels = make_state(self.config, len(BOTH))
        self._parcels.noise[:, :, 3] = NOT_LOST
        line, kind = self.config.chosen_line, self.config.action_kind
        self._plan = BodyPlan((), self._placement, len(BOTH), (line.rows, line.columns))
        self._scratch = make_scratch()
        self.shape = (kind.rows, kind.columns)  # shape of the widest zone
        self.entered: ParcelEntry | None = None
        # Any parcel, for compilation.
        self._settle(self.config.task.parcels[0])
        self._compile()

    def _compile(self) -> None:
        """Compile all functions in advance."""
        functions, given = task_functions(self.config), self._arrays
        self._mirror = functions.mirror
        self._begin = compile_for(make_begin(functions), *given, SEEN)
        self._show = compile_for(make_show(functions), *given, NOW)
        move = make_move(functions.update_sensor, type(self.config.sensors).__name__)
        self._move = compile_for(move, *given, self._scratch, SEEN, 0.1, 1, 0.1, True, *self._looks)
        bodies, axes = self._plan.bodies, np.zeros(self.shape)
        self._use_axes = compile_for(use_encoders, self._surfaces, bodies, 0, SEEN, axes)

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return self._params, self._surfaces, self._parcels, self._plan.bodies

    def _placement(self, parcel: Parcel) -> Placement:
        return place_parcel(parcel, self.config.chosen_line, self.config.zone)

    def _settle(self, parcel: Parcel) -> None:
        parcels = Parcels((parcel,), np.zeros(len(BOTH), dtype=np.int64))
        self._parcels.body[:] = self._plan.bodies_of(BOTH, parcels)

    def reset(self, entered: ParcelEntry) -> None:
        task = self.config.task
        goal = checks.array("goal", entered.goal, (task.goals,))
        task.check_goal(goal)
        path = None
        if task.has_path:
            path = checks.array("path", entered.path, (st.PATH_POINTS,))
            checks.limited("path", path, checks.FARTHEST)
        pose = checks.pose("pose", entered.pose, (3,))
        velocity = checks.velocity("velocity", entered.velocity, (3,))
        # The load's position is unknown, so assume an even load.
        self._settle(replace(entered.parcel, com_offset=(0.0, 0.0)))
        parcels, conditions = self._parcels, self._surfaces.conditions
        parcels.sensor_state[:] = 0.0
        parcels.state[:] = (*pose, *velocity, 0.0, 0.0)
        parcels.goal[:] = goal
        if path is not None:
            parcels.path[:] = path
        conditions[:] = 1.0
        conditions[:, st.GRAVITY_COLUMNS] = split_gravity(entered.tilt, entered.tilt_direction)
        for i in (SEEN, NOW):
            self._begin(*self._arrays, i)
        self._commands.clear()
        self._at = entered.at
        self.entered = entered

    def clear(self) -> None:
        self.entered = None

    def depart(self, number: int) -> bool:
        """Forget the parcel if its number is `number`. Return whether the parcel was forgotten."""
        if self.entered is None or self.entered.number != number:
            return False
        self.clear()
        return True

    def correct(self, frame: Frame) -> bool:
        """Correct the estimate by a frame, and return whether the frame was used.

        A frame is not used if it shows another parcel, or is not later than the latest frame.
        """
        pose = checks.pose("pose", frame.pose, (3,))
        axes = None if frame.axes is None else checks.array("axes", frame.axes, self.shape)
        if self.entered is None or frame.number != self.entered.number:
            return False
        self._parcels.truth[SEEN, :3] = pose
        if not self._see(frame.taken_at, looks=True):
            return False
        if axes is not None:
            body = int(self._parcels.body[SEEN])
            self._use_axes(self._surfaces, self._plan.bodies, body, SEEN, np.array(axes))
        return True

    def observe(self, now: float) -> NDArray[np.float32]:
        """Return a copy of the task's observation (features,) at a time [s]."""
        parcels, surfaces = self._parcels, self._surfaces
        for array in (parcels.sensor_state, parcels.clock, parcels.steps):
            array[NOW] = array[SEEN]
        for array in (surfaces.angle, surfaces.target, surfaces.direction):
            array[NOW] = array[SEEN]
        self._advance(NOW, self._at, min(now, self._at + MAX_LATE), looks=False)
        self._show(*self._arrays, NOW)
        return parcels.observation[NOW].copy()

    @property
    def estimate(self) -> NDArray[np.float64]:
        """Pose and velocity (6,) [m, m, rad, m/s, m/s, rad/s] at the time of the last `observe`."""
        return self._parcels.sensed[NOW].copy()

    def _make_obey(self, kind: actions.ActionKind) -> Any:
        return make_obey(kind, self._mirror)

    def _arguments(self, command: NDArray[Any]) -> tuple[Any, ...]:
        params, surfaces, parcels, bodies = self._arrays
        return params, surfaces._replace(command=command), parcels, bodies

    def _move_on(self, i: int, begun: float, until: float, looks: bool) -> None:
        """Move environment i from `begun` to `until` [s], in equal steps of at most `timing.dt`."""
        steps = math.ceil((until - begun) / self._params.timing.dt - 1e-6)
        if steps > 0:
            length = (until - begun) / steps
            given = (length, steps, self._axis_speed, looks, *self._looks)
            self._move(*self._arrays, self._scratch, i, *given)

    def _zone_angles(self, whole: NDArray[np.float64]) -> Angles:
        return zone_angles(whole, self._plan.bodies.zone[self._parcels.body[NOW]], self.shape)


def make_looks(numbers: Array) -> tuple[Array, Array]:
    """Return two copies of a camera's parameters, with the delay set to 0.

    The camera takes no frames with the first copy, and a frame in each step with the second copy.
    """
    coasting, looking = np.array(numbers), np.array(numbers)
    coasting[EVERY], coasting[LAG] = NEVER, 0.0
    looking[EVERY], looking[LAG] = 1.0, 0.0
    return coasting, looking


@compiled
def use_encoders(
    surfaces: st.SurfaceState, bodies: st.BodyTable, body: int, i: int, angles: Array
) -> None:
    """Set the axes of environment `i` to the measured angles.

    `angles` (rows, columns) [rad] covers the zone of every parcel. Angles outside the present
    parcel's zone are ignored. `body` is the parcel's row in `bodies`.
    """
    zone = bodies.zone[body]
    margin = (angles.shape[0] - zone[st.ROWS]) // 2
    for down in range(zone[st.ROWS]):
        for along in range(zone[st.COLUMNS]):
            row, column = zone[st.FIRST_ROW] + down, zone[st.FIRST_COLUMN] + along
            angle = angles[margin + down, along]
            axis = surfaces.axis[i, row, column]
            surfaces.angle[i, row, column] = angle
            cosine, sine = axis_direction(angle)
            surfaces.direction[i, axis, 0] = cosine
            surfaces.direction[i, axis, 1] = sine


@lru_cache(maxsize=16)
def make_begin(functions: KernelFunctions) -> Any:
    """Make `begin`, which sets all axes to 90 deg, and sets the estimate to `parcels.state`."""
    task_begin, sensor_begin = functions.begin, functions.begin_sensor

    def begin(
        params: EnvParams,
        surfaces: st.SurfaceState,
        parcels: st.ParcelState,
        bodies: st.BodyTable,
        i: int,
    ) -> None:
        actions.straighten_targets(params.acting, surfaces, i)
        parcels.clock[i] = 0.0
        parcels.steps[i] = 0
        parcels.period[i] = 0.0
        parcels.noise_row[i, 0] = 0
        state = st.env_state(surfaces, parcels, bodies, i, i, params.elements)
        st.read_truth(state)
        sensor_begin(params.sensor, state)
        task_begin(state)

    return compiled(begin, f"estimator-begin-{functions.label}")


@lru_cache(maxsize=16)
def make_move(update: Function, label: str) -> Any:
    """Make the function `move`, which predicts a state over several steps by a sensor's `update`.

    In `move`, a step lasts `length` [s] and turns the axes at `axis_speed` [rad/s]. If the argument
    `looks` of `move` is true, the last step also corrects the estimate by a frame. The frame's pose
    is in `parcels.truth`.
    """

    def move(
        params: EnvParams,
        surfaces: st.SurfaceState,
        parcels: st.ParcelState,
        bodies: st.BodyTable,
        scratch: Scratch,
        i: int,
        length: float,
        steps: int,
        axis_speed: float,
        looks: bool,
        coasting: Array,
        looking: Array,
    ) -> None:
        physics = Physics(params.assumed, params.stiffness, scratch, length)
        acting = actions.ActionParams(
            params.acting.zone_rows,
            params.acting.orientations,
            axis_speed * length,
            params.acting.modes,
            params.acting.ramp,
        )
        invalidate_contacts(scratch)
        parcels.noise_row[i, 0] = 0
        for k in range(steps):
            parcels.clock[i] += length
            parcels.steps[i] += 1
            state = st.env_state(surfaces, parcels, bodies, i, i, params.elements)
            if actions.turn_axes(acting, surfaces, i, state.zone):
                invalidate_contacts(scratch)
            update(looking if looks and k == steps - 1 else coasting, state, physics)

    return compiled(move, f"estimator-move-{label}")


@lru_cache(maxsize=16)
def make_show(functions: KernelFunctions) -> Any:
    """Compile `show`, which writes the task's observation of the estimated state."""
    task_observe, task_mirror = functions.observe, functions.mirror
    read_sensor, show_more = functions.read_sensor, showing(functions)

    def show(
        params: EnvParams,
        surfaces: st.SurfaceState,
        parcels: st.ParcelState,
        bodies: st.BodyTable,
        i: int,
    ) -> None:
        state = st.env_state(surfaces, parcels, bodies, i, i, params.elements)
        read_sensor(params.sensor, state)
        mirror = task_mirror(state)
        task_observe(state)
        show_more(params, state, mirror)

    return compiled(show, f"estimator-show-{functions.label}")


@lru_cache(maxsize=16)
def make_obey(kind: actions.ActionKind, mirror_of: Function) -> Any:
    """Make `obey`, which sets the targets of an environment's axes from the command.

    `mirror_of` is the task's function `mirror`, which returns -1 if actions are mirrored, else 1.
    """
    obey_command = obeying(
        kind.part_of, actions.aim_at_angle if kind.continuous else actions.aim_at_choice
    )

    def obey(
        params: EnvParams,
        surfaces: st.SurfaceState,
        parcels: st.ParcelState,
        bodies: st.BodyTable,
        i: int,
    ) -> None:
        state = st.env_state(surfaces, parcels, bodies, i, i, params.elements)
        obey_command(params, surfaces, state, i, mirror_of(state))

    return compiled(obey, f"estimator-{kind.name}-{'angles' if kind.continuous else 'choices'}")
