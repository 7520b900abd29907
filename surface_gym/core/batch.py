"""Batches: environments of one configuration, stepped together by compiled code."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import state as st
from surface_gym.canvas import Pixels
from surface_gym.compiler.jit import CompilerError, compile_for, compiled
from surface_gym.config import REWARD, EnvConfig
from surface_gym.core import resets
from surface_gym.core.assembly import FEWEST, Workers, make_env_params, make_state, task_functions
from surface_gym.core.kernel import EnvParams, add_loads, make_kernel
from surface_gym.core.pictures import make_drawing, make_viewport
from surface_gym.core.wear import WearMeter
from surface_gym.modules import surface_velocities
from surface_gym.parcel import Parcel
from surface_gym.physics import types as ph
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.types import Array, Booleans, Integers, Scratch
from surface_gym.state import BodyTable, EnvState, ParcelState, SurfaceState
from surface_gym.tasks.start import Parcels, Start

NO_ENVS: Integers = np.zeros(0, dtype=np.int64)
Infos = dict[str, NDArray[Any]]
COMPILED = ("_kernel", "_draw")  # compiled functions of a batch, which pickling leaves out


class Snapshot(NamedTuple):
    """Copied states of some environments. A batch can continue from these states."""

    arrays: dict[str, NDArray[Any]]  # by name, (count, ...)
    parcels: Any  # parcels of each environment, in the form of the batch
    generators: list[Mapping[str, Any]]  # states of generators, if sensors draw noise in an episode

    def __len__(self) -> int:
        return len(self.parcels)


class BaseBatch(ABC):
    """Environments of one configuration: reset, stepped and observed together.

    Args:
        threads: number of threads, which does not change results.
        max_episode_steps: control periods after which an episode is truncated; None means never.
        compiles: whether to make the kernel; a batch without a kernel only holds memory.
    """

    parcels: ParcelState  # state of every parcel
    surfaces: SurfaceState  # state of every surface
    params: EnvParams  # parameters common to all environments
    rows: int = 1  # of each environment in `parcels`

    def __init__(
        self, config: EnvConfig, num_envs: int, threads: int = 1,
        max_episode_steps: int | None = None, compiles: bool = True,
    ) -> None:  # fmt: skip
        self.config = config
        self.task = config.task
        self.num_envs = num_envs
        self.outcomes = st.COMMON_OUTCOMES + config.task.outcomes  # names by number in `outcome`
        self.term_names = tuple(REWARD + term for term in config.task.terms)  # in infos
        self._draws = config.draws
        self._threads = min(threads, max(1, num_envs // FEWEST))
        self._all = np.arange(num_envs)
        self._limit = max_episode_steps
        self._steps_remaining = np.zeros(num_envs, dtype=np.int64)
        self.params = make_env_params(config)
        self.surfaces, self.parcels = make_state(config, num_envs)
        self._wear = WearMeter(config, self.surfaces)
        self._make_memory()
        steps = config.timing.steps * self.rows
        self._workers = Workers(self._threads, steps, self._make_scratch)
        if compiles:
            self._kernel = self._compile()

    @abstractmethod
    def _make_memory(self) -> None:
        """Allocate the memory needed in addition to the state arrays of surfaces and parcels."""

    @abstractmethod
    def _make_scratch(self) -> Any:
        """Allocate scratch memory of the physics for one thread."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the values that `reset(options=...)` may set."""
        return self.task.options

    @property
    @abstractmethod
    def bodies(self) -> BodyTable:
        """The body table, one row per parcel. A row also has the surface's rotors and zone."""

    @property
    @abstractmethod
    def episodes(self) -> Any:
        """The arrays that hold outcome, fault, reward, clock and terms of each environment."""

    @property
    def outcome(self) -> Integers:
        """(num_envs,) state of each episode, an index into `outcomes`."""
        return self.episodes.outcome

    @property
    def reward(self) -> Array:
        """(num_envs,) rewards of the last control period."""
        return self.episodes.reward

    @property
    def terms(self) -> Array:
        """Reward terms (num_envs, terms) of the last period, in the order of `term_names`."""
        return self.episodes.terms

    @property
    def observation(self) -> NDArray[np.float32]:
        """A view of the observations (num_envs, features).

        A stream's observations have the shape (num_envs, rows, features). Pictures have the shape
        (num_envs, height, width, channels).
        """
        return self.parcels.observation

    @property
    def truncated(self) -> Booleans:
        """(num_envs,) whether the time limit is reached."""
        late: Booleans = self.outcome == st.OUT_OF_TIME
        return late if self._limit is None else late | (self._steps_remaining <= 0)

    @property
    @abstractmethod
    def _arrays(self) -> tuple[Any, ...]:
        """The arrays that compiled code reads and writes."""

    @property
    def arguments(self) -> tuple[Any, ...]:
        """Arguments with which the kernel steps all environments in one thread."""
        return (*self._arrays, *self._workers.scratches, self._all)

    @abstractmethod
    def make_kernel(self) -> Any:
        """Build the kernel of this configuration, not compiled yet."""

    def _fault(self) -> ValueError:
        """Return an error that describes the fault of the first faulty environment."""
        name, fault = type(self.task).__name__, self.episodes.fault
        i = int(np.nonzero(fault)[0][0])
        if fault[i] == st.UNKNOWN_OUTCOME:
            return ValueError(
                f"{name}.outcome must return RUNNING, SUCCESS or a failure, one of the numbers of "
                f"{self.outcomes}, got {self.outcome[i]}"
            )
        if fault[i] == st.BAD_REWARD:
            terms = dict(zip(self.task.terms, self.terms[i].tolist(), strict=True))
            return ValueError(f"{name}.reward must write finite terms, got {terms}")
        features = self.config.features
        observed = self.parcels.observation.reshape(self.num_envs, self.rows, -1)[i]
        wrong = ~np.isfinite(observed).all(axis=0)
        listed = ", ".join(features[k].name for k in np.nonzero(wrong)[0])
        return ValueError(
            f"{name}.observe, with {type(self.config.sensors).__name__}, must write finite "
            f"features, got others for {listed}"
        )

    @abstractmethod
    def place_drawn(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        """Draw an episode for each chosen environment (count,) by the environment's own generator.

        `options` holds the reset options of each chosen environment, or is empty.
        """

    @abstractmethod
    def seed(self, env_index: int, generator: np.random.Generator) -> None:
        """Set an environment's generator; do nothing if the environment already has `generator`."""

    @abstractmethod
    def generator(self, env_index: int) -> np.random.Generator | None:
        """Return an environment's generator. Before the first call of `seed`, return None."""

    @abstractmethod
    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Check reset options, one dictionary per environment. Draw no random numbers."""

    @abstractmethod
    def infos(self) -> Infos:
        """Return the infos of all environments by name, as copied arrays (num_envs, ...)."""

    def info(self, env_index: int) -> dict[str, Any]:
        """Return the info of one environment, with copied arrays."""
        return {
            name: values[env_index].copy() if values.ndim > 1 else values[env_index].item()
            for name, values in self.infos().items()
        }

    @abstractmethod
    def parcel(self, env_index: int, row: int = 0) -> Parcel:
        """Return an environment's randomised parcel. In a stream, the parcel is in row `row`."""

    def is_seeded(self, env_index: int) -> bool:
        return self.generator(env_index) is not None

    def reset(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        """Begin an episode in the chosen, seeded environments. For arguments see `place_drawn`."""
        self.place_drawn(chosen, options)
        self.begin(chosen)

    def begin(self, chosen: Integers) -> None:
        """Begin episodes in the chosen environments (count,), from the starts placed there.

        The first observation is written, too.
        """
        self._restart_clock(chosen)
        self._run(chosen)

    def step(self, commands: NDArray[Any], anew: Integers = NO_ENVS) -> None:
        """Step every running environment by one control period.

        Args:
            commands: (num_envs, command size), without effect for ended environments.
            anew: (count,) indices of ended environments that begin a new episode instead of a step.
        """
        self.surfaces.command[:] = commands
        if self._draws:
            self._draw_noise_ahead()
        if len(anew) > 0:
            self.place_drawn(anew)
        self._run(self._all, self._threads)
        if self._limit is not None:
            self._steps_remaining -= 1
            self._restart_clock(anew)
            outcome = self.outcome
            outcome[(self._steps_remaining <= 0) & (outcome == st.RUNNING)] = st.OUT_OF_TIME

    def _restart_clock(self, chosen: Integers) -> None:
        if self._limit is not None:
            self._steps_remaining[chosen] = self._limit

    def _draw_noise_ahead(self) -> None:
        """Draw more sensor noise for each parcel that may run out of noise in the next period.

        After an episode's end, no noise is drawn. So the random generator, which also draws the
        next start, has the same state as in a single environment.
        """
        used = self.parcels.noise_row.reshape(-1, self.rows)
        running = (self.outcome == st.RUNNING)[:, np.newaxis]
        for i, row in np.argwhere(running & (used + self._draws > st.NOISE_ROWS)).tolist():
            resets.draw_noise(self.parcels, i * self.rows + row, self._generator(i))

    def _generator(self, env_index: int) -> np.random.Generator:
        generator = self.generator(env_index)
        assert generator is not None
        return generator

    def snapshot(self, chosen: Integers | int | None = None, axes: bool = True) -> Snapshot:
        """Copy the states of environments.

        Args:
            chosen: index of an environment, or indices (count,) in any order, possibly repeated. If
                None, copy the states of all environments.
            axes: whether axes and commands are copied too.
        """
        chosen = self._all if chosen is None else np.atleast_1d(chosen)
        states = []
        if self._draws:
            states = [self._generator(i).bit_generator.state for i in chosen.tolist()]
        arrays = {name: array[chosen] for name, array in self._state(axes).items()}
        return Snapshot(arrays, self._copy_parcels(chosen), states)

    def restore(self, snapshot: Snapshot, chosen: Integers | int | None = None) -> None:
        """Restore environments from a snapshot of this batch or a batch of equal configuration.

        The restored environments continue exactly like the copied environments. If sensors draw
        noise, the random generators are restored, too, so later resets change. Without noise,
        later resets do not change.

        Args:
            snapshot: one state for each chosen environment, or one state for all.
            chosen: an index, or indices (count,). None means all environments.
        """
        chosen = self._all if chosen is None else np.atleast_1d(chosen)
        if len(snapshot) not in (1, len(chosen)):
            raise ValueError(
                f"snapshot must be of 1 or {len(chosen)} environments, got {len(snapshot)}"
            )
        for name, array in self._state(axes=True).items():
            held = snapshot.arrays.get(name)
            if held is not None and array.ndim > 1:  # arrays of streams may have grown since
                array[chosen, : held.shape[1]] = held
            elif held is not None:
                array[chosen] = held
        self._put_parcels(chosen, snapshot.parcels)
        for k, i in enumerate(chosen.tolist() if snapshot.generators else ()):
            self._generator(i).bit_generator.state = snapshot.generators[k % len(snapshot)]

    def fork(self, parents: Integers, axes: bool = True) -> None:
        """Copy the environments `parents` (count,) into the first `count` environments.

        All other environments end. If `axes` is true, axes and commands are copied, too.
        """
        count = len(parents)
        self.restore(self.snapshot(parents, axes), self._all[:count])
        self.outcome[count:] = st.OUT_OF_TIME

    def _state(self, axes: bool) -> dict[str, NDArray[Any]]:
        """Return views of the state arrays (num_envs, ...) by name.

        If `axes` is false, arrays of axes, commands and loads are left out.
        """
        found: dict[str, NDArray[Any]] = {"steps_remaining": self._steps_remaining}
        for name, array in self.parcels._asdict().items():
            if array.size:
                found[f"parcels.{name}"] = array.reshape(self.num_envs, self.rows, *array.shape[1:])
        if self._wear.turns.size:
            found |= {"wear.turns": self._wear.turns, "wear.moving": self._wear.moving}
        for name, array in self.surfaces._asdict().items():
            if len(array) == self.num_envs and (axes or name in ("conditions", "stiffness")):
                found[f"surfaces.{name}"] = array
        return found

    @abstractmethod
    def _copy_parcels(self, chosen: Integers) -> Any:
        """Copy the parcels of the chosen environments (count,)."""

    @abstractmethod
    def _put_parcels(self, chosen: Integers, parcels: Any) -> None:
        """Restore the parcels of the chosen environments (count,) from a snapshot."""

    def axes(self, env_index: int) -> Array:
        """(rows, columns) [rad] axis angles of an environment."""
        return st.axis_angles(self.surfaces, slice(env_index, env_index + 1))[0]

    def surface_velocity(self, env_index: int) -> Array | None:
        """Return the velocities (rows, columns, 2) [m/s] of the modules' surfaces.

        They are NaN for idle modules. The result is None if no module has a drive.
        """
        if not self.config.module_kind.drives:
            return None
        surfaces, angles = self.surfaces, self.axes(env_index)
        own = env_index if len(surfaces.drive) > 1 else 0
        drive = surfaces.drive[own, surfaces.axis[env_index].ravel()]
        velocity = surface_velocities(np.column_stack([angles.ravel(), drive]))
        velocity[drive[:, st.DRIVEN] == 0.0] = np.nan
        return velocity.reshape(*angles.shape, 2)

    def view(self, env_index: int, row: int = 0) -> EnvState:
        """Return the `EnvState` of an environment's parcel in `row`, between control periods."""
        place = env_index * self.rows + row
        elements = self.params.elements
        seen: EnvState = st.env_state.py_func(
            self.surfaces, self.parcels, self.bodies, env_index, place, elements
        )
        return seen

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in COMPILED}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._kernel = self._compile()

    def _compile(self) -> Callable[..., int]:
        """Compile the kernel, or load it from the cache."""
        try:
            return compile_for(self.make_kernel(), *self.arguments)
        except CompilerError as error:
            raise ValueError(f"{self._authors} does not compile: {error}") from error

    def _sizes(self) -> dict[str, int]:
        """Return the sizes of the arrays that functions of a task or sensor index, by name."""
        task = self.task
        return {
            "features": len(task.features),
            "terms": self.parcels.terms.shape[1],
            "metrics": len(task.metrics),
            "goals": task.goals,
            "memories": task.memories,
            "sensor numbers": self.config.sensors.sensor_size,
            "rows of noise": self.parcels.noise.shape[1],
        }

    @property
    def _authors(self) -> str:
        return f"{type(self.task).__name__} with {type(self.config.sensors).__name__}"

    def _run(self, chosen: Integers, threads: int = 1) -> None:
        """Step the chosen environments (count,) by one control period.

        If an environment has a new start, begin the new episode instead.
        """
        before = self._wear.look(self.surfaces, self.outcome)
        try:
            faults = self._workers.run(threads, self._kernel, self._arrays, chosen)
        except IndexError as error:
            sizes = ", ".join(f"{size} {name}" for name, size in self._sizes().items())
            raise ValueError(
                f"{self._authors} must keep within their arrays, {sizes}: "
                "one index is out of bounds"
            ) from error
        self._wear.count(self.surfaces, before)
        if faults:
            raise self._fault()


class Batch(BaseBatch):
    """Environments of a task of one parcel. Arguments and errors are as for `BaseBatch`."""

    def _make_memory(self) -> None:
        config, line = self.config, self.config.chosen_line
        self._randomisation = config.randomisation
        self._varies = config.randomisation.varies
        shared = self._varies or self._draws > 0 or config.actuators.stuck_share > 0.0
        self.reset_cache = resets.ResetCache(self.num_envs, self.task.draws, shared)
        # Paths need too much memory to be prepared ahead.
        self._lays_out = not (shared or self.task.has_path)
        place, shape = partial(resets.place_in, config), (line.rows, line.columns)
        self._plan = resets.BodyPlan(self.task.parcels, place, self.num_envs, shape)
        self._pictures: Pixels | None = None
        if config.image is not None:
            self._pictures = np.zeros((self.num_envs, *config.image.shape), dtype=np.uint8)
            self._viewport = make_viewport(config)

    def _make_scratch(self) -> Any:
        return ph.make_scratch()

    @property
    def bodies(self) -> BodyTable:
        return self._plan.bodies

    @property
    def episodes(self) -> ParcelState:
        return self.parcels

    @property
    def _arrays(self) -> tuple[EnvParams, SurfaceState, ParcelState, BodyTable]:
        return self.params, self.surfaces, self.parcels, self.bodies

    @property
    def observation(self) -> NDArray[Any]:
        return self.parcels.observation if self._pictures is None else self._pictures

    def make_kernel(self) -> Any:
        return make_kernel(task_functions(self.config))

    def _compile(self) -> Callable[..., int]:
        if self._pictures is not None:
            given = (*self._drawn, *self._workers.scratches, self._all)
            try:
                self._draw = compile_for(make_drawing(self.config), *given)
            except CompilerError as error:
                name = type(self.task).__name__
                raise ValueError(f"{name}.draw_goal does not compile: {error}") from error
        return super()._compile()

    @property
    def _drawn(self) -> tuple[Any, ...]:
        """Arguments of the kernel that draws pictures. The last entry holds the pictures."""
        assert self._pictures is not None
        _, *states = self._arrays
        flat = self._pictures.reshape(*self._pictures.shape[:2], -1)
        return self.params.elements, *states, self._viewport, flat

    def _run(self, chosen: Integers, threads: int = 1) -> None:
        super()._run(chosen, threads)
        if self._pictures is not None:
            try:
                self._workers.run(threads, self._draw, self._drawn, chosen)
            except IndexError as error:
                name = type(self.task).__name__
                raise ValueError(f"{name}.draw_goal must keep within its arrays") from error

    def _state(self, axes: bool) -> dict[str, NDArray[Any]]:
        found = super()._state(axes)
        return found if self._pictures is None else found | {"pictures": self._pictures}

    def seed(self, env_index: int, generator: np.random.Generator) -> None:
        self.reset_cache.seed(env_index, generator)

    def generator(self, env_index: int) -> np.random.Generator | None:
        return self.reset_cache.generators[env_index]

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        numbers = np.full((len(options), self.task.draws), 0.5)
        start = resets.draw_starts(self.config, numbers, options)
        for parcel in resets.each_parcel(start.parcel, len(options)).kinds:
            resets.place_in(self.config, parcel)

    def infos(self) -> Infos:
        state = self.parcels
        return {
            "is_success": state.outcome == st.SUCCESS,
            "time": state.clock.copy(),
            "pose": state.truth[:, :3].copy(),
            "velocity": state.truth[:, 3:].copy(),
            "parcel": self._plan.sizes[state.body],
            **dict(zip(self.task.metrics, state.metrics.T.copy(), strict=True)),
            **self._wear.infos(self.surfaces),
            **(self._on_request() if self.config.info else {}),
        }

    def info(self, env_index: int) -> dict[str, Any]:
        if self.config.has_extras:
            return super().info(env_index)
        state = self.parcels  # faster for a single environment than arrays of all
        truth = state.truth[env_index].copy()
        return {
            "is_success": state.outcome.item(env_index) == st.SUCCESS,
            "time": state.clock.item(env_index),
            "pose": truth[:3],
            "velocity": truth[3:],
            "parcel": self._plan.sizes[state.body.item(env_index)].copy(),
            **dict(zip(self.task.metrics, state.metrics[env_index].tolist(), strict=True)),
        }

    def parcel(self, env_index: int, row: int = 0) -> Parcel:
        del row
        return self._plan.parcel(int(self.parcels.body[env_index]))

    def _copy_parcels(self, chosen: Integers) -> Any:
        return self._plan.copy(self.parcels.body[chosen])

    def _put_parcels(self, chosen: Integers, parcels: Any) -> None:
        self.parcels.body[chosen] = self._plan.put(chosen, parcels)

    def place_drawn(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        if options or not self._lays_out:
            self.place(
                chosen, resets.draw_starts(self.config, self.reset_cache.take(chosen), options)
            )
            return
        rows = self.reset_cache.take_rows(chosen, self._lay_out)
        if rows.body.min() < 0:  # the starts have other parcels than the task's
            self._lays_out = False
            self.place(
                chosen, resets.draw_starts(self.config, self.reset_cache.taken(chosen), options)
            )
        else:
            self._put(chosen, rows)

    def _lay_out(self, numbers: Array) -> resets.StartRows:
        """Make starts from random numbers (starts, draws). Parcels not in the task have body -1."""
        start = resets.draw_starts(self.config, numbers, ())
        parcels = resets.each_parcel(start.parcel, len(numbers))
        return resets.start_rows(self.task, start, parcels, self._plan.shared_bodies_of(parcels))

    def place(self, chosen: Integers, start: Start) -> None:
        """Place starts in environments `chosen` (count,). `begin` or `step` begins the episodes.

        An environment's generator draws randomisation, stuck modules and sensor noise, in this
        order.
        """
        count = len(chosen)
        parcels = resets.each_parcel(start.parcel, count)
        factors = np.ones((count, 3))
        if self._varies:
            parcels, start = self._vary(chosen, parcels, start, factors)
        rows = resets.start_rows(self.task, start, parcels, self._plan.bodies_of(chosen, parcels))
        rows.conditions[:, :3] = factors
        self._put(chosen, rows)
        if self.task.has_path:
            self.parcels.path[chosen] = resets.start_paths(self.task, start, count)
        if self.config.actuators.stuck_share:
            self._draw_stuck(chosen, parcels)
        if self._draws:
            for i in chosen.tolist():
                resets.draw_noise(self.parcels, i, self._generator(i))

    def _put(self, chosen: Integers, rows: resets.StartRows) -> None:
        """Write starts into the memory of the chosen environments (count,)."""
        state = self.parcels
        state.body[chosen] = rows.body
        state.state[chosen] = rows.state
        self.surfaces.conditions[chosen] = rows.conditions
        state.goal[chosen] = rows.goal
        state.outcome[chosen] = st.STARTING

    def _vary(
        self, chosen: Integers, parcels: Parcels, start: Start, factors: Array
    ) -> tuple[Parcels, Start]:
        """Randomise and return the parcels and starts of the chosen environments (count,).

        Also write factors of friction to `factors` (count, 3), and stiffness to the surfaces.
        """
        kinds, aside, turned = [], np.zeros(len(chosen)), np.zeros(len(chosen))
        x, y, theta = start.pose
        _, _, low, high = self.config.chosen_line.extent
        middle = np.broadcast_to(y, len(chosen))
        shape = self.surfaces.axis.shape[1:]
        for k, i in enumerate(chosen.tolist()):
            room = (low - float(middle[k]), high - float(middle[k]))
            drawn = self._randomisation.draw(
                self._generator(i), parcels.kinds[parcels.which[k]], shape, room
            )
            kinds.append(drawn.parcel)
            aside[k], turned[k] = drawn.aside, drawn.turned
            factors[k] = drawn.friction
            if drawn.stiffness is not None:
                self.surfaces.stiffness[i] = drawn.stiffness
        varied = start._replace(pose=(x, np.add(y, aside), np.add(theta, turned)))
        return Parcels(tuple(kinds), np.arange(len(kinds))), varied

    def _draw_stuck(self, chosen: Integers, parcels: Parcels) -> None:
        shape, share = self.surfaces.axis.shape[1:], self.config.actuators.stuck_share
        for k, i in enumerate(chosen.tolist()):
            working = self._generator(i).random(shape) >= share
            parcel = parcels.kinds[parcels.which[k]]
            self.parcels.body[i] = self._plan.draw_stuck(i, parcel, working)

    def _on_request(self) -> Infos:
        """Return the infos requested by `info=`, by name.

        Axis angles [rad] and normal forces [N] have shape (num_envs, rows, columns), with one entry
        per element. The numbers in `ENERGIES` have shape (num_envs,), and cover the episode so far.
        """
        found: Infos = {}
        if self.config.meters:
            found |= dict(zip(st.ENERGIES, self.parcels.energy.T.copy(), strict=True))
        if "axes" in self.config.info:
            found["axes"] = st.axis_angles(self.surfaces)
        if "normal_forces" in self.config.info:
            loads = np.zeros((*self.surfaces.axis.shape, 2))
            map_normal_forces(*self._arrays, self._workers.scratches[0], loads)
            used, which = np.unique(self.parcels.body, return_inverse=True)
            mass = np.array([self._plan.parcel(body).mass for body in used])[which]
            found["normal_forces"] = loads[..., st.NOW] * mass[:, np.newaxis, np.newaxis]
        return found


@compiled
def map_normal_forces(
    params: EnvParams,
    surfaces: SurfaceState,
    parcels: ParcelState,
    bodies: BodyTable,
    scratch: Scratch,
    loads: Array,
) -> None:
    """Write normal forces / mass [m/s^2] into `loads` (num_envs, rows, columns, 2).

    Entry NOW of the last dimension is the present force. Entry PEAK_LOAD is the largest force on a
    module so far.
    """
    for i in range(parcels.clock.shape[0]):
        row = parcels.body[i]
        grid = st.read_grid(surfaces, bodies, i, row, params.elements, params.friction)
        invalidate_contacts(scratch)
        add_loads(grid, st.read_body(bodies, row), parcels.state[i], 1.0, scratch, loads[i])
