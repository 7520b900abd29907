"""The shadow: where the parcel is by what the device says, and what a task shows of it.

It keeps two lanes of the package's own memory. `SEEN` stands at the latest frame: it is moved on by
the physics from frame to frame, with the axes as they turned, and corrected there. `NOW` is a copy
of it, moved on to the time of the decision: however late a frame is, it corrects the estimate of
the time it was taken at, and what was commanded since is done once more.
"""

import math
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.core.actions import ActionKind
from surface_gym.core.batch import functions_of, memory_of, rules_of
from surface_gym.core.resets import BodyPlan, Placement, place_parcel
from surface_gym.parcel import Parcel
from surface_gym.physics.jit import compile_for
from surface_gym.physics.types import GRAVITY, make_scratch
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.settings import Settings
from surface_gym.state import GRAVITY_ALONG, GRAVITY_NORMAL, PATH_POINTS
from surface_gym.tasks.base import Parcels

from .axis_guard import within_right_angles
from .device import Angles, Entered, Frame
from .estimate import looks_of, make_begin, make_move, make_obey, make_show, use_encoders
from .sensing import camera_of
from .told import Resolver, Told
from .zone import of_zone

SEEN, NOW = 0, 1  # the lanes
LANES = np.array([SEEN, NOW])
MOST_AHEAD = 1.0  # [s] from a frame that the estimate is moved on; it stands still thereafter
LEAST_APART = 1e-6  # [s] between frames that differ
NOT_LOST = 1.0  # [-] a uniform number with which no frame is dropped


class Shadow:
    """What the controller holds for true.

    Args:
        settings: of the environment that the policy is for, its sensors a `Camera` or `Exact`.

    Raises:
        ValueError: the sensors are others, or a task lacks one of its compiled functions.
    """

    def __init__(self, settings: Settings) -> None:
        self._axis_speed = min(settings.actuators.axis_speed, checks.AXIS_SPEED[1])
        self.settings = replace(
            settings,
            sensors=camera_of(settings.sensors),
            actuators=Actuators(axis_speed=self._axis_speed),
            randomisation=Randomisation(),
        )
        rules = rules_of(self.settings)
        offered = within_right_angles(rules.acting.orientations)
        self._rules = rules._replace(acting=rules.acting._replace(orientations=offered))
        self._looks = looks_of(rules.sensor)
        self._surfaces, self._lanes = memory_of(self.settings, len(LANES))
        self._lanes.noise[:, :, 3] = NOT_LOST
        plant, kind = self.settings.chosen_plant, self.settings.action_kind
        self._plan = BodyPlan((), self._placement, len(LANES), (plant.rows, plant.columns))
        self._scratch = make_scratch()
        self._told: deque[Told] = deque()
        self._at = 0.0  # [s] of the lane SEEN
        self.shape = (kind.rows, kind.columns)  # of the widest zone
        self.entered: Entered | None = None
        # A site, of any parcel, so that there is something to compile for.
        self._settle(self.settings.chosen_task.parcels[0])
        self._compile()

    def _compile(self) -> None:
        """All that is called, for arrays as they are, so that nothing is compiled later."""
        functions, given = functions_of(self.settings), self._arrays
        self._mirror = functions.mirror
        self._begin = compile_for(make_begin(functions), *given, SEEN)
        self._show = compile_for(make_show(functions), *given, NOW)
        move = make_move(functions.look, type(self.settings.sensors).__name__)
        self._move = compile_for(move, *given, self._scratch, SEEN, 0.1, 1, 0.1, True, *self._looks)
        sites, axes = self._plan.bodies, np.zeros(self.shape)
        self._use_axes = compile_for(use_encoders, self._surfaces, sites, 0, SEEN, axes)

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return self._rules, self._surfaces, self._lanes, self._plan.bodies

    def _placement(self, parcel: Parcel) -> Placement:
        return place_parcel(parcel, self.settings.chosen_plant, self.settings.zone)

    def _settle(self, parcel: Parcel) -> None:
        parcels = Parcels((parcel,), np.zeros(len(LANES), dtype=np.int64))
        self._lanes.site[:] = self._plan.bodies_of(LANES, parcels)

    def enter(self, entered: Entered) -> None:
        """Begin with a parcel.

        Raises:
            ValueError: the parcel does not fit the surface, or its goal or path is not the task's.
        """
        task = self.settings.chosen_task
        goal = checks.array("goal", entered.goal, (task.goals,))
        path = checks.array("path", entered.path, (PATH_POINTS,)) if task.has_path else None
        pose = checks.pose("pose", entered.pose, (3,))
        velocity = checks.velocity("velocity", entered.velocity, (3,))
        # Its load may lie anywhere: it is taken as evenly spread.
        self._settle(replace(entered.parcel, com_offset=(0.0, 0.0)))
        lanes, conditions = self._lanes, self._surfaces.conditions
        lanes.kept[:] = 0.0
        lanes.state[:] = (*pose, *velocity, 0.0, 0.0)
        lanes.goal[:] = goal
        if path is not None:
            lanes.path[:] = path
        conditions[:] = 1.0
        conditions[:, GRAVITY_ALONG] = GRAVITY * math.sin(entered.tilt)
        conditions[:, GRAVITY_NORMAL] = GRAVITY * math.cos(entered.tilt)
        for lane in (SEEN, NOW):
            self._begin(*self._arrays, lane)
        self._told.clear()
        self._at = entered.at
        self.entered = entered

    def leave(self) -> None:
        """The parcel is gone."""
        self.entered = None

    def see(self, frame: Frame) -> bool:
        """Correct the estimate by a frame; whether it was of any use: one of another parcel is
        none, nor one that is no later than the latest.

        Raises:
            ValueError: a pose or axes that are none.
        """
        pose = checks.pose("pose", frame.pose, (3,))
        axes = None if frame.axes is None else checks.array("axes", frame.axes, self.shape)
        if self.entered is None or frame.number != self.entered.number:
            return False
        if frame.taken < self._at + LEAST_APART:
            return False
        self._lanes.truth[SEEN, :3] = pose
        self._advance(SEEN, max(self._at, frame.taken - MOST_AHEAD), frame.taken, looks=True)
        self._at = frame.taken
        while self._told and self._told[0].at <= self._at:
            self._told.popleft()
        if axes is not None:
            site = int(self._lanes.site[SEEN])
            self._use_axes(self._surfaces, self._plan.bodies, site, SEEN, np.array(axes))
        return True

    def observe(self, now: float) -> NDArray[np.float32]:
        """(features,) what the task shows of the parcel at a time [s]: a copy."""
        lanes, surfaces = self._lanes, self._surfaces
        for of_lanes in (lanes.kept, lanes.clock, lanes.steps):
            of_lanes[NOW] = of_lanes[SEEN]
        for of_surfaces in (surfaces.angle, surfaces.target, surfaces.direction):
            of_surfaces[NOW] = of_surfaces[SEEN]
        self._advance(NOW, self._at, min(now, self._at + MOST_AHEAD), looks=False)
        self._show(*self._arrays, NOW)
        seen: NDArray[np.float32] = lanes.observation[NOW].copy()
        return seen

    @property
    def estimate(self) -> NDArray[np.float64]:
        """(6,) [m, m, rad, m/s, m/s, rad/s] of the time last observed."""
        sensed: NDArray[np.float64] = self._lanes.sensed[NOW].copy()
        return sensed

    def axes(self) -> Angles:
        """(rows, columns) [rad] of the zone's modules, at the time last observed."""
        return self._of_zone(self._surfaces.angle[NOW])

    def longest_turn(self, angles: Angles) -> float:
        """[s] until the last of the zone's modules has turned to angles (rows, columns) [rad]."""
        apart = angles - self.axes()
        apart -= math.pi * np.floor(apart / math.pi + 0.5)
        return float(np.abs(apart).max()) / self._axis_speed

    def resolver(self, kind: ActionKind) -> Resolver:
        """What turns commands of a kind into the modules' axes."""
        dtype = np.float64 if kind.continuous else np.int64
        surfaces = self._surfaces._replace(command=np.zeros((len(LANES), kind.size), dtype=dtype))
        obey = make_obey(kind, self._mirror)
        rules, _, lanes, sites = self._arrays
        return Resolver(compile_for(obey, rules, surfaces, lanes, sites, NOW), surfaces)

    def resolve(self, resolver: Resolver, command: NDArray[Any]) -> Angles:
        """(rows, columns) [rad] that a command (size,) of some kind has the zone's modules turn
        to, by the parcel's place at the time last observed.
        """
        resolver.surfaces.command[NOW] = command
        resolver.obey(self._rules, resolver.surfaces, self._lanes, self._plan.bodies, NOW)
        return self._of_zone(self._surfaces.target[NOW])

    def tell(self, command: int, at: float) -> None:
        """The device was told to turn the axes as last resolved, from a time [s] on."""
        self._told.append(Told(command, at, self._surfaces.target[NOW].copy()))

    def taken(self, command: int, at: float) -> None:
        """The device says when [s] the axes of a command began to turn."""
        least = self._at
        for told in self._told:
            if told.command == command:
                told.at = at
            least = told.at = max(least, told.at)

    def forget(self, command: int) -> None:
        """The device did not take a command."""
        self._told = deque(told for told in self._told if told.command != command)

    def _advance(self, lane: int, begun: float, until: float, looks: bool) -> None:
        """Move a lane on, with what was told in between."""
        for told in self._told:
            if told.at >= until:
                break
            self._move_on(lane, begun, told.at, looks=False)
            begun = max(begun, told.at)
            self._surfaces.target[lane] = told.target
        self._move_on(lane, begun, until, looks)

    def _move_on(self, lane: int, begun: float, until: float, looks: bool) -> None:
        """Move a lane on in equal steps, none longer than the package's."""
        steps = math.ceil((until - begun) / self._rules.timing.dt - 1e-6)
        if steps > 0:
            length = (until - begun) / steps
            given = (length, steps, self._axis_speed, looks, *self._looks)
            self._move(*self._arrays, self._scratch, lane, *given)

    def _of_zone(self, whole: NDArray[np.float64]) -> Angles:
        """Of the whole surface's (rows, columns) those of the widest zone."""
        return of_zone(whole, self._plan.bodies.zone[self._lanes.site[NOW]], self.shape)
