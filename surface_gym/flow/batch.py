"""A batch of flows: streams are drawn for them, commands move them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from surface_gym.core.batch import FEWEST, Workers
from surface_gym.core.kernel import EnvParams
from surface_gym.core.resets import draw_noise
from surface_gym.flow.episodes import FlowEpisodes
from surface_gym.flow.kernel import make_flow_kernel
from surface_gym.flow.making import stream_functions
from surface_gym.flow.memory import FlowRules, Flows
from surface_gym.flow.settings import FlowSettings
from surface_gym.physics.collision import make_world_scratch
from surface_gym.physics.jit import compile_for
from surface_gym.physics.types import Array, Integers
from surface_gym.state import (
    NOISE_ROWS,
    RUNNING,
    BodyTable,
    EnvState,
    ParcelState,
    SurfaceState,
    env_state,
)

NO_LANES: Integers = np.zeros(0, dtype=np.int64)


class FlowBatch(FlowEpisodes):
    """Surfaces of one environment, each with a stream of parcels of its own.

    Args:
        settings: of the environment.
        lanes: number of surfaces.
        threads: that share them; results do not depend on their number.

    Raises:
        ValueError: the sensor lacks a compiled function, or it does not compile.
    """

    def __init__(self, settings: FlowSettings, lanes: int, threads: int = 1) -> None:
        super().__init__(settings, lanes)
        self._threads = min(threads, max(1, lanes // FEWEST))
        steps = settings.timing.steps * self.rows  # of a parcel
        self._workers = Workers(self._threads, steps, _Scratch(self.rows))
        self._all = np.arange(lanes)
        self._move = self._compile()

    @property
    def outcome(self) -> Integers:
        """(lanes,) how each episode stands, a place in `outcomes`."""
        return self.streams.outcome

    @property
    def observation(self) -> NDArray[np.float32]:
        """(lanes, rows, features) what each shows: a view."""
        return self.parcels.observation.reshape(len(self._all), self.rows, -1)

    @property
    def reward(self) -> Array:
        """(lanes,) of the last control period."""
        return self.streams.reward

    @property
    def _arrays(self) -> tuple[EnvParams, FlowRules, SurfaceState, ParcelState, BodyTable, Flows]:
        """What compiled code reads and writes."""
        return self.rules, self.flow_rules, self.surfaces, self.parcels, self.bodies, self.streams

    def start(self, chosen: Integers, options: Sequence[dict[str, Any]] = ()) -> None:
        """Begin an episode on the chosen lanes (count,), which are seeded.

        Args:
            chosen: lanes.
            options: of each; none at all: no lane has any.
        """
        self.place(chosen, options)
        self._run(chosen)

    def advance(self, commands: NDArray[Any], anew: Integers = NO_LANES) -> None:
        """Move every lane that has not ended over one control period.

        Args:
            commands: (lanes, command size), of lanes that have ended without effect.
            anew: (count,) lanes that have ended, to begin another episode instead.
        """
        self.surfaces.command[:] = commands
        if self._draws:
            rows = self.parcels.noise_row.reshape(-1, self.rows)
            running = (self.streams.outcome == RUNNING)[:, np.newaxis]
            short = running & (rows + self._draws > NOISE_ROWS)
            for lane, place in np.argwhere(short).tolist():
                draw_noise(self.parcels, lane * self.rows + place, self._generator(lane))
        if len(anew) > 0:
            self.place(anew)
        self._run(self._all, self._threads)

    def view(self, lane: int, place: int) -> EnvState:
        """The parcel of a place as compiled functions see it, between two control periods."""
        row = lane * self.rows + place
        elements = self.rules.elements
        seen: EnvState = env_state.py_func(
            self.surfaces, self.parcels, self.bodies, lane, row, elements
        )
        return seen

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_move"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._move = self._compile()

    def _compile(self) -> Callable[..., int]:
        settings = self.settings
        kernel = make_flow_kernel(stream_functions(settings))
        try:
            return compile_for(kernel, *self._arrays, *self._workers.scratches, self._all)
        except NumbaError as error:
            raise ValueError(
                f"{type(settings.sensors).__name__} does not compile: {error}"
            ) from error

    def _run(self, chosen: Integers, threads: int = 1) -> None:
        """Move the chosen lanes (count,), or begin those just placed."""
        faults = self._workers.run(threads, self._move, self._arrays, chosen)
        if faults:
            sensor = type(self.settings.sensors).__name__
            raise ValueError(f"{sensor} must write finite numbers, got others")


class _Scratch:
    """Makes the physics' scratch of one thread; a class, for it to be pickled."""

    def __init__(self, places: int) -> None:
        self._places = places

    def __call__(self) -> Any:
        return make_world_scratch(self._places)
