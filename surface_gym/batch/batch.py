"""A batch of lanes: starts are placed on it, commands move it."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from surface_gym.batch.bearing import bear_lanes
from surface_gym.batch.faults import beyond_arrays, fault_of, not_compiling
from surface_gym.batch.functions import functions_of
from surface_gym.batch.kernels import Rules, make_kernel
from surface_gym.batch.making import memory_of, rules_of
from surface_gym.batch.noise import draw_noise
from surface_gym.batch.placement import placement_in
from surface_gym.batch.reserve import Reserve
from surface_gym.batch.sites import SitePlan
from surface_gym.batch.starts import Rows, parcels_of, path_of, rows_of, starts_of
from surface_gym.batch.workers import FEWEST, Workers
from surface_gym.dynamics.compiled import entry_of
from surface_gym.dynamics.types import Array, Integers
from surface_gym.lanes.axes import angles_of
from surface_gym.lanes.lane import Lane, lane_of
from surface_gym.lanes.memory import (
    COMMON_OUTCOMES,
    NOISE_ROWS,
    PLACED,
    RUNNING,
    Lanes,
    Sites,
    Surfaces,
)
from surface_gym.settings import Settings
from surface_gym.tasks.start import Parcels, Start

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
        self.reserve = Reserve(lanes, self.task.draws, shared)
        # A path takes too much memory to lay it out ahead.
        self._lays_out = not (shared or self.task.has_path)
        self.rules = rules_of(settings)
        self.surfaces: Surfaces
        self.lanes: Lanes
        self.surfaces, self.lanes = memory_of(settings, lanes)
        self._placement = partial(placement_in, settings)
        self._plan = SitePlan(
            self.task.parcels, self._placement, lanes, (plant.rows, plant.columns)
        )
        self._threads = min(threads, max(1, lanes // FEWEST))
        self._workers = Workers(self._threads, settings.timing.steps)
        self._all = np.arange(lanes)
        # How an episode may stand, by the numbers of `Lanes.outcome`.
        self.outcomes = COMMON_OUTCOMES + self.task.outcomes
        self._move = self._compile()

    @property
    def options(self) -> tuple[str, ...]:
        """What `reset(options=...)` may fix."""
        return self.task.options

    @property
    def outcome(self) -> Integers:
        """(lanes,) how each episode stands, a place in `outcomes`."""
        return self.lanes.outcome

    @property
    def observation(self) -> NDArray[np.float32]:
        """(lanes, features) what each shows."""
        return self.lanes.observation

    @property
    def reward(self) -> Array:
        """(lanes,) of the last control period."""
        return self.lanes.reward

    @property
    def sites(self) -> Sites:
        """The parcels of all lanes as they run on the plant."""
        return self._plan.sites

    @property
    def _arrays(self) -> tuple[Rules, Surfaces, Lanes, Sites]:
        """What compiled code reads and writes."""
        return self.rules, self.surfaces, self.lanes, self.sites

    def _compile(self) -> Callable[..., int]:
        """The kernel for these settings: compiled, or from the cache."""
        settings = self.settings
        kernel = make_kernel(functions_of(settings))
        arguments = (*self._arrays, *self._workers.scratches, self._all)
        try:
            return entry_of(kernel, *arguments)
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
        start = starts_of(self.settings, numbers, options)
        for parcel in parcels_of(start.parcel, len(options)).kinds:
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
            self.place(chosen, starts_of(self.settings, self.reserve.take(chosen), options))
            return
        rows = self.reserve.take_rows(chosen, self._lay_out)
        if rows.site.min() < 0:  # the task's starts come with parcels of their own
            self._lays_out = False
            self.place(chosen, starts_of(self.settings, self.reserve.taken(chosen), options))
        else:
            self._put(chosen, rows)

    def _lay_out(self, numbers: Array) -> Rows:
        """Rows of the starts that numbers (starts, draws) come to, of the task's own parcels."""
        start = starts_of(self.settings, numbers, ())
        parcels = parcels_of(start.parcel, len(numbers))
        return rows_of(self.task, start, parcels, self._plan.shared_sites_of(parcels))

    def place(self, chosen: Integers, start: Start) -> None:
        """Put a start on each of the chosen lanes (count,), every axis at 90 deg as the conveyor's;
        then `begin` them.

        The randomisation, the stuck modules and the sensor's noise are drawn from a lane's
        generator, in that order.
        """
        count = len(chosen)
        parcels = parcels_of(start.parcel, count)
        factors = np.ones((count, 3))
        if self._varies:
            parcels, start = self._vary(chosen, parcels, start, factors)
        rows = rows_of(self.task, start, parcels, self._plan.sites_of(chosen, parcels))
        rows.conditions[:, :3] = factors
        self._put(chosen, rows)
        if self.task.has_path:
            self.lanes.path[chosen] = path_of(self.task, start, count)
        if self.settings.actuators.stuck_share:
            self._draw_stuck(chosen, parcels)
        if self._draws:
            for lane in chosen.tolist():
                draw_noise(self.lanes, lane, self._generator(lane))

    def _put(self, chosen: Integers, rows: Rows) -> None:
        """Into the memory of the chosen lanes (count,)."""
        lanes = self.lanes
        lanes.site[chosen] = rows.site
        lanes.state[chosen] = rows.state
        self.surfaces.conditions[chosen] = rows.conditions
        lanes.goal[chosen] = rows.goal
        lanes.outcome[chosen] = PLACED

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
            self.lanes.site[lane] = self._plan.draw_stuck(lane, parcel, working)

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
            short = self.lanes.noise_row[:, 0] + self._draws > NOISE_ROWS
            for lane in np.nonzero(short & (self.lanes.outcome == RUNNING))[0].tolist():
                draw_noise(self.lanes, lane, self._generator(lane))
        if len(anew) > 0:
            self._place_drawn(anew)
        self._run(self._all, self._threads)

    def on_request(self) -> dict[str, Array]:
        """What `info` carries on request, by name, each (lanes, rows, columns): axis angles [rad],
        and what each element bears of its lane's parcel [N] as it stands.
        """
        found = {}
        if "axes" in self.settings.info:
            found["axes"] = angles_of(self.surfaces)
        if "normal_forces" in self.settings.info:
            loads = np.zeros(self.surfaces.axis.shape)
            bear_lanes(*self._arrays, self._workers.scratches[0], loads)
            sites, which = np.unique(self.lanes.site, return_inverse=True)
            mass = np.array([self._plan.parcel(site).mass for site in sites])[which]
            found["normal_forces"] = loads * mass[:, np.newaxis, np.newaxis]
        return found

    def axes(self, lane: int) -> Array:
        """(rows, columns) [rad] axis angles of a lane."""
        angles: Array = angles_of(self.surfaces, slice(lane, lane + 1))[0]
        return angles

    def view(self, lane: int) -> Lane:
        """A lane as its task's functions see it, between two control periods."""
        elements = self.rules.elements
        seen: Lane = lane_of.py_func(self.surfaces, self.lanes, self.sites, lane, lane, elements)
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
            raise fault_of(self.settings, self.lanes, self.outcomes)
