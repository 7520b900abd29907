"""A batch of environments: starts are placed on it, commands move it."""

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from surface_gym.core.actions import (
    CONVEYOR,
    Acting,
    aim_at_angle,
    aim_at_choice,
    leave_axes,
    set_angle,
    set_choice,
    show_nothing,
    show_occupancy,
    show_window_axes,
    show_zone_axes,
    shown,
    straighten_angles,
    straighten_choices,
    straighten_targets,
    turn_axes,
)
from surface_gym.core.kernel import Actuation, EnvParams, Function, KernelFunctions, make_kernel
from surface_gym.core.resets import (
    BodyPlan,
    ResetCache,
    StartRows,
    draw_noise,
    draw_starts,
    each_parcel,
    place_in,
    start_paths,
    start_rows,
)
from surface_gym.physics.contacts import bounded, invalidate_contacts
from surface_gym.physics.jit import compile_for, compiled
from surface_gym.physics.step import axis_directions, find_support, support_load
from surface_gym.physics.types import (
    ARM_X,
    ARM_Y,
    NORMAL,
    Array,
    Integers,
    Scratch,
    X,
    Y,
    make_scratch,
)
from surface_gym.sensors.base import Sensor
from surface_gym.settings import Settings
from surface_gym.state import (
    BAD_OBSERVATION,
    BAD_REWARD,
    COMMON_OUTCOMES,
    NOISE_ROWS,
    RUNNING,
    STARTING,
    UNKNOWN_OUTCOME,
    BodyTable,
    EnvState,
    ParcelState,
    Sizes,
    SurfaceState,
    axis_angles,
    env_state,
    make_parcels,
    make_surfaces,
    read_body,
    read_grid,
)
from surface_gym.tasks.base import Parcels, Start, Task


def not_compiling(settings: Settings, error: Exception) -> ValueError:
    """One of the functions does not compile."""
    return ValueError(f"{_task(settings)} with {_sensor(settings)} does not compile: {error}")


def beyond_arrays(settings: Settings) -> ValueError:
    """One of the functions reads or writes beyond the end of an array."""
    task, sensors = settings.chosen_task, settings.sensors
    return ValueError(
        f"{_task(settings)} and {_sensor(settings)} must keep within their arrays, "
        f"{len(task.features)} features, {len(task.terms)} terms, {len(task.metrics)} metrics, "
        f"{task.goals} goals, {task.memories} memories, {sensors.sensor_size} sensor numbers: "
        f"one index is out of bounds"
    )


def fault_of(settings: Settings, lanes: ParcelState, outcomes: tuple[str, ...]) -> ValueError:
    """What a function wrote on the first lane that has a fault."""
    lane = int(np.nonzero(lanes.fault)[0][0])
    task = _task(settings)
    if lanes.fault[lane] == UNKNOWN_OUTCOME:
        return ValueError(
            f"{task}.outcome must return RUNNING, SUCCESS or a failure, one of the numbers of "
            f"{outcomes}, got {lanes.outcome[lane]}"
        )
    if lanes.fault[lane] == BAD_REWARD:
        names = settings.chosen_task.terms
        terms = dict(zip(names, lanes.terms[lane].tolist(), strict=True))
        return ValueError(f"{task}.reward must write finite terms, got {terms}")
    assert lanes.fault[lane] == BAD_OBSERVATION
    bad = ~np.isfinite(lanes.observation[lane])
    listed = ", ".join(
        feature.name for feature, wrong in zip(settings.features, bad, strict=True) if wrong
    )
    return ValueError(
        f"{task}.observe, of what {_sensor(settings)} says, must write finite features, "
        f"got others for {listed}"
    )


def _task(settings: Settings) -> str:
    return type(settings.chosen_task).__name__


def _sensor(settings: Settings) -> str:
    return type(settings.sensors).__name__


FEWEST = 4  # lanes that a thread is worth its while for
LOOK = 20_000  # steps of a parcel that a thread takes in a row: Ctrl-C waits for no more
PARTS = 16  # of a thread's share of the lanes; the last two are taken by whoever is done early


class Workers:
    """One thread or more; results do not depend on their number.

    Args:
        threads: their number.
        steps: of parcels, that a lane takes in a call.
        make: makes the physics' scratch of one.
    """

    def __init__(self, threads: int, steps: int, make: Callable[[], Any] = make_scratch) -> None:
        self._most = max(1, LOOK // steps)  # lanes in a row
        self._pool: ThreadPoolExecutor | None = None
        self._process = os.getpid()
        # Of the physics, and of the sensor.
        self._scratches = [(make(), make_scratch()) for _ in range(threads)]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pool": None}

    @property
    def scratches(self) -> tuple[Any, Scratch]:
        """Those of the first thread."""
        return self._scratches[0]

    def run(
        self, threads: int, move: Callable[..., int], arrays: tuple[Any, ...], chosen: Integers
    ) -> int:
        """Call `move(*arrays, scratch, sensor's scratch, chosen)` over the chosen lanes.

        Returns:
            The sum of what it returns.
        """
        if threads == 1:
            return self._in_pieces(move, (*arrays, *self._scratches[0]), chosen)
        if self._pool is None or self._process != os.getpid():  # a fork has none of the threads
            self._pool = ThreadPoolExecutor(len(self._scratches) - 1)
            self._process = os.getpid()
        # A thread has the same lanes each time, which its core has in its memory still.
        cuts = [k * len(chosen) // (PARTS * threads) for k in range(PARTS * threads + 1)]
        firsts = range(0, PARTS * threads, PARTS)
        left = iter(
            [
                chosen[cuts[k] : cuts[k + 1]]
                for first in firsts
                for k in (first + PARTS - 2, first + PARTS - 1)
            ]
        )

        def work(thread: int) -> int:
            scratches = self._scratches[thread]
            own = chosen[cuts[PARTS * thread] : cuts[PARTS * thread + PARTS - 2]]
            given = (*arrays, *scratches)
            done = self._in_pieces(move, given, own)
            return done + sum(self._in_pieces(move, given, part) for part in left)

        others = [self._pool.submit(work, thread) for thread in range(1, threads)]
        return work(0) + sum(other.result() for other in others)

    def _in_pieces(self, move: Callable[..., int], given: tuple[Any, ...], chosen: Integers) -> int:
        """Call `move(*given, chosen)`, some lanes at a time, between which Python sees Ctrl-C."""
        if len(chosen) <= self._most:
            return move(*given, chosen)
        firsts = range(0, len(chosen), self._most)
        return sum(move(*given, chosen[first : first + self._most]) for first in firsts)


@compiled
def bear_lanes(
    rules: EnvParams,
    surfaces: SurfaceState,
    lanes: ParcelState,
    sites: BodyTable,
    scratch: Scratch,
    loads: Array,
) -> None:
    """Write the normal force over the mass [m/s^2] of each element into `loads` (lanes, rows,
    columns); 0 where none is.
    """
    table = scratch.table
    elements = rules.elements
    for i in range(lanes.clock.shape[0]):
        for row in range(loads.shape[1]):
            for column in range(loads.shape[2]):
                loads[i, row, column] = 0.0
        site = lanes.body[i]
        grid = read_grid(surfaces, sites, i, site, elements, rules.friction)
        body = read_body(sites, site)
        state = lanes.state[i]
        invalidate_contacts(scratch)
        contacts = find_support(grid, body, state, scratch, 0.0)
        if contacts.total == 0:
            continue
        support_load(grid, body, state, scratch, contacts)
        for k in range(contacts.total):
            along = (state[X] + table[ARM_X + k] - elements.x0) / elements.pitch_x
            across = (state[Y] + table[ARM_Y + k] - elements.y0) / elements.pitch_y
            column = round(bounded(along, 0.0, loads.shape[2] - 1))
            row = round(bounded(across, 0.0, loads.shape[1] - 1))
            loads[i, int(row), int(column)] = table[NORMAL + k]


def functions_of(settings: Settings) -> KernelFunctions:
    """What the kernel of an environment is built from.

    Raises:
        ValueError: a task or a sensor lacks one of its compiled functions.
    """
    task, sensor, kind = settings.chosen_task, settings.sensors, settings.action_kind
    begin_sensor, update, read = sensor_functions_of(sensor)
    window = kind.name == "window"
    show_axes = show_window_axes if window else show_zone_axes
    return KernelFunctions(
        label=f"{type(task).__name__}-{type(sensor).__name__}-{kind.name}",
        begin=_function(task, "begin", Task),
        is_done=_function(task, "is_done", Task),
        outcome=_function(task, "outcome", Task),
        reward=_function(task, "reward", Task),
        observe=_function(task, "observe", Task),
        mirror=_function(task, "mirror", Task),
        begin_sensor=begin_sensor,
        update_sensor=update,
        read_sensor=read,
        watches=sensor.watches,
        part_of=kind.part_of,
        actuation=actuation_of(kind.continuous, settings.actuators.axis_speed != math.inf),
        show_modules=show_occupancy if window else show_nothing,
        show_axes=show_axes if settings.observe_axes else show_nothing,
        learned=_function(sensor, "learned", Sensor),
        more=shown(settings.observe),
    )


def actuation_of(any_angle: bool, turning: bool) -> Actuation:
    """How axes obey: set at any angle or to one of those on offer, at once or turning."""
    if turning:
        aim = aim_at_angle if any_angle else aim_at_choice
        return Actuation(aim, turn_axes, straighten_targets, turns=True)
    if any_angle:
        return Actuation(set_angle, leave_axes, straighten_angles, turns=False)
    return Actuation(set_choice, leave_axes, straighten_choices, turns=False)


def sensor_functions_of(sensor: Sensor) -> tuple[Function, Function, Function]:
    """A sensor's `begin`, `update` and `read`.

    Raises:
        ValueError: it lacks one of them.
    """
    begin, update, read = (_function(sensor, name, Sensor) for name in ("begin", "update", "read"))
    return begin, update, read


def _function(owner: Any, name: str, kind: type[Any]) -> Function:
    function: Function | None = getattr(owner, name, None)
    if not isinstance(function, Dispatcher):
        raise ValueError(
            f"{type(owner).__name__}.{name} must be a static method and a kernel_function, as "
            f"{kind.__name__} says, got {function!r}"
        )
    return function


def rules_of(settings: Settings) -> EnvParams:
    """The rules of an environment."""
    task, kind = settings.chosen_task, settings.action_kind
    features = len(task.features)
    outcomes = len(COMMON_OUTCOMES) + len(task.outcomes)
    return surface_rules_of(settings, features, features + kind.window_size, outcomes)


def surface_rules_of(settings: Any, features: int, axes_from: int, outcomes: int) -> EnvParams:
    """The rules of surfaces, by an environment's settings.

    Args:
        settings: of whatever runs on them.
        features: that are observed of it.
        axes_from: place in the observation from which axes are shown.
        outcomes: that there are.
    """
    plant, timing, kind = settings.chosen_plant, settings.timing, settings.action_kind
    return EnvParams(
        elements=plant.geometry,
        timing=timing,
        acting=Acting(
            kind.rows,
            np.array(settings.chosen_orientations),
            settings.actuators.axis_speed * timing.dt,
        ),
        friction=plant.friction.copy(),
        assumed=settings.sensors.friction(plant).copy(),
        stiffness=np.ones((plant.rows, plant.columns)),
        sensor=np.array(settings.sensors.numbers(timing.dt), dtype=np.float64),
        features=features,
        axes_from=axes_from,
        outcomes=outcomes,
    )


def memory_of(settings: Settings, lanes: int) -> tuple[SurfaceState, ParcelState]:
    """Memory for lanes of an environment, every axis the conveyor's."""
    task, plant, kind = settings.chosen_task, settings.chosen_plant, settings.action_kind
    sizes = Sizes(
        num_envs=lanes,
        rows=plant.rows,
        columns=plant.columns,
        command=kind.size,
        choices=kind.choices,
        observation=len(settings.features),
        terms=len(task.terms),
        goals=task.goals,
        memories=task.memories,
        metrics=len(task.metrics),
        sensor_state=settings.sensors.sensor_size,
        path=task.has_path,
        noise=settings.draws > 0,
        turning=settings.actuators.axis_speed != math.inf,
        stiffness=settings.randomisation.stiffness > 0.0,
    )
    return surfaces_of(settings, sizes), make_parcels(sizes)


def surfaces_of(settings: Any, sizes: Sizes) -> SurfaceState:
    """Memory for surfaces whose axes are all the conveyor's, by an environment's settings."""
    surfaces = make_surfaces(sizes)
    surfaces.direction[:] = CONVEYOR
    if sizes.choices and not sizes.turning:  # axes count the orientations on offer
        angles = np.array(settings.chosen_orientations)
        surfaces.direction[0, :-1] = axis_directions(angles)
        surfaces.axis[:] = len(angles)
    return surfaces


NO_LANES: Integers = np.zeros(0, dtype=np.int64)


class Batch:
    """Lanes of one environment, each one parcel on one surface.

    Args:
        settings: of the environment.
        lanes: their number.
        threads: that share the lanes; results do not depend on their number.

    Raises:
        ValueError: the task or the sensor lacks a compiled function, or one does not compile.
    """

    def __init__(self, settings: Settings, lanes: int, threads: int = 1) -> None:
        self.settings = settings
        self.task = settings.chosen_task
        plant = settings.chosen_plant
        self._randomisation = settings.randomisation
        self._varies = settings.randomisation.varies
        self._draws = settings.draws
        shared = self._varies or self._draws > 0 or settings.actuators.stuck_share > 0.0
        self.reserve = ResetCache(lanes, self.task.draws, shared)
        # A path takes too much memory to lay it out ahead.
        self._lays_out = not (shared or self.task.has_path)
        self.rules = rules_of(settings)
        self.surfaces: SurfaceState
        self.parcels: ParcelState
        self.surfaces, self.parcels = memory_of(settings, lanes)
        self._placement = partial(place_in, settings)
        self._plan = BodyPlan(
            self.task.parcels, self._placement, lanes, (plant.rows, plant.columns)
        )
        self._threads = min(threads, max(1, lanes // FEWEST))
        self._workers = Workers(self._threads, settings.timing.steps)
        self._all = np.arange(lanes)
        # How an episode may stand, by the numbers of `ParcelState.outcome`.
        self.outcomes = COMMON_OUTCOMES + self.task.outcomes
        self._move = self._compile()

    @property
    def options(self) -> tuple[str, ...]:
        """What `reset(options=...)` may fix."""
        return self.task.options

    @property
    def outcome(self) -> Integers:
        """(lanes,) how each episode stands, a place in `outcomes`."""
        return self.parcels.outcome

    @property
    def observation(self) -> NDArray[np.float32]:
        """(lanes, features) what each shows."""
        return self.parcels.observation

    @property
    def reward(self) -> Array:
        """(lanes,) of the last control period."""
        return self.parcels.reward

    @property
    def bodies(self) -> BodyTable:
        """The parcels of all lanes as they run on the plant."""
        return self._plan.bodies

    @property
    def _arrays(self) -> tuple[EnvParams, SurfaceState, ParcelState, BodyTable]:
        """What compiled code reads and writes."""
        return self.rules, self.surfaces, self.parcels, self.bodies

    def _compile(self) -> Callable[..., int]:
        """The kernel for these settings: compiled, or from the cache."""
        settings = self.settings
        kernel = make_kernel(functions_of(settings))
        arguments = (*self._arrays, *self._workers.scratches, self._all)
        try:
            return compile_for(kernel, *arguments)
        except NumbaError as error:
            raise not_compiling(settings, error) from error

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_move"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._move = self._compile()

    def seed(self, lane: int, generator: np.random.Generator) -> None:
        """Draw a lane's starts from a generator; one that it has already goes on."""
        self.reserve.seed(lane, generator)

    def is_seeded(self, lane: int) -> bool:
        """Whether a lane has a generator."""
        return self.reserve.generators[lane] is not None

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Raise what `start` would for options of as many lanes, and draw nothing."""
        numbers = np.full((len(options), self.task.draws), 0.5)
        start = draw_starts(self.settings, numbers, options)
        for parcel in each_parcel(start.parcel, len(options)).kinds:
            self._placement(parcel)

    def start(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        """Begin an episode on the chosen lanes (count,), which are seeded.

        Args:
            chosen: lanes.
            options: of each; none at all: no lane has any.
        """
        self._place_drawn(chosen, options)
        self.begin(chosen)

    def _place_drawn(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        """Put a start on each of the chosen lanes (count,), which are seeded."""
        if options or not self._lays_out:
            self.place(chosen, draw_starts(self.settings, self.reserve.take(chosen), options))
            return
        rows = self.reserve.take_rows(chosen, self._lay_out)
        if rows.body.min() < 0:  # the task's starts come with parcels of their own
            self._lays_out = False
            self.place(chosen, draw_starts(self.settings, self.reserve.taken(chosen), options))
        else:
            self._put(chosen, rows)

    def _lay_out(self, numbers: Array) -> StartRows:
        """Rows of the starts that numbers (starts, draws) come to, of the task's own parcels."""
        start = draw_starts(self.settings, numbers, ())
        parcels = each_parcel(start.parcel, len(numbers))
        return start_rows(self.task, start, parcels, self._plan.shared_bodies_of(parcels))

    def place(self, chosen: Integers, start: Start) -> None:
        """Put a start on each of the chosen lanes (count,), every axis at 90 deg as the conveyor's;
        then `begin` them.

        The randomisation, the stuck modules and the sensor's noise are drawn from a lane's
        generator, in that order.
        """
        count = len(chosen)
        parcels = each_parcel(start.parcel, count)
        factors = np.ones((count, 3))
        if self._varies:
            parcels, start = self._vary(chosen, parcels, start, factors)
        rows = start_rows(self.task, start, parcels, self._plan.bodies_of(chosen, parcels))
        rows.conditions[:, :3] = factors
        self._put(chosen, rows)
        if self.task.has_path:
            self.parcels.path[chosen] = start_paths(self.task, start, count)
        if self.settings.actuators.stuck_share:
            self._draw_stuck(chosen, parcels)
        if self._draws:
            for lane in chosen.tolist():
                draw_noise(self.parcels, lane, self._generator(lane))

    def _put(self, chosen: Integers, rows: StartRows) -> None:
        """Into the memory of the chosen lanes (count,)."""
        lanes = self.parcels
        lanes.body[chosen] = rows.body
        lanes.state[chosen] = rows.state
        self.surfaces.conditions[chosen] = rows.conditions
        lanes.goal[chosen] = rows.goal
        lanes.outcome[chosen] = STARTING

    def _vary(
        self, chosen: Integers, parcels: Parcels, start: Start, factors: Array
    ) -> tuple[Parcels, Start]:
        """Parcels and start as drawn; the friction's factors (count, 3) are written."""
        kinds, aside, turned = [], np.zeros(len(chosen)), np.zeros(len(chosen))
        x, y, theta = start.pose
        _, _, low, high = self.settings.chosen_plant.extent
        middle = np.broadcast_to(y, len(chosen))
        shape = self.surfaces.axis.shape[1:]
        for k, lane in enumerate(chosen.tolist()):
            room = (low - float(middle[k]), high - float(middle[k]))
            drawn = self._randomisation.draw(
                self._generator(lane), parcels.kinds[parcels.which[k]], shape, room
            )
            kinds.append(drawn.parcel)
            aside[k], turned[k] = drawn.aside, drawn.turned
            factors[k] = drawn.friction
            if drawn.stiffness is not None:
                self.surfaces.stiffness[lane] = drawn.stiffness
        varied = start._replace(pose=(x, np.add(y, aside), np.add(theta, turned)))
        return Parcels(tuple(kinds), np.arange(len(kinds))), varied

    def _draw_stuck(self, chosen: Integers, parcels: Parcels) -> None:
        shape, share = self.surfaces.axis.shape[1:], self.settings.actuators.stuck_share
        for k, lane in enumerate(chosen.tolist()):
            working = self._generator(lane).random(shape) >= share
            parcel = parcels.kinds[parcels.which[k]]
            self.parcels.body[lane] = self._plan.draw_stuck(lane, parcel, working)

    def begin(self, chosen: Integers) -> None:
        """Sense and observe the chosen lanes (count,), on which starts were placed."""
        self._run(chosen)

    def advance(self, commands: NDArray[Any], anew: Integers = NO_LANES) -> None:
        """Move every lane that has not ended over one control period.

        Args:
            commands: (lanes, command size), of lanes that have ended without effect.
            anew: (count,) lanes that have ended, to begin another episode instead.
        """
        self.surfaces.command[:] = commands
        if self._draws:
            # Not for a lane that has ended: its next start must find the generator as a single
            # env would.
            short = self.parcels.noise_row[:, 0] + self._draws > NOISE_ROWS
            for lane in np.nonzero(short & (self.parcels.outcome == RUNNING))[0].tolist():
                draw_noise(self.parcels, lane, self._generator(lane))
        if len(anew) > 0:
            self._place_drawn(anew)
        self._run(self._all, self._threads)

    def on_request(self) -> dict[str, Array]:
        """What `info` carries on request, by name, each (lanes, rows, columns): axis angles [rad],
        and what each element bears of its lane's parcel [N] as it stands.
        """
        found = {}
        if "axes" in self.settings.info:
            found["axes"] = axis_angles(self.surfaces)
        if "normal_forces" in self.settings.info:
            loads = np.zeros(self.surfaces.axis.shape)
            bear_lanes(*self._arrays, self._workers.scratches[0], loads)
            sites, which = np.unique(self.parcels.body, return_inverse=True)
            mass = np.array([self._plan.parcel(site).mass for site in sites])[which]
            found["normal_forces"] = loads * mass[:, np.newaxis, np.newaxis]
        return found

    def axes(self, lane: int) -> Array:
        """(rows, columns) [rad] axis angles of a lane."""
        angles: Array = axis_angles(self.surfaces, slice(lane, lane + 1))[0]
        return angles

    def view(self, lane: int) -> EnvState:
        """A lane as its task's functions see it, between two control periods."""
        elements = self.rules.elements
        seen: EnvState = env_state.py_func(
            self.surfaces, self.parcels, self.bodies, lane, lane, elements
        )
        return seen

    def _generator(self, lane: int) -> np.random.Generator:
        generator = self.reserve.generators[lane]
        assert generator is not None
        return generator

    def _run(self, chosen: Integers, threads: int = 1) -> None:
        """Move the chosen lanes (count,), or begin those just placed."""
        try:
            faults = self._workers.run(threads, self._move, self._arrays, chosen)
        except IndexError as error:
            raise beyond_arrays(self.settings) from error
        if faults:
            raise fault_of(self.settings, self.parcels, self.outcomes)
