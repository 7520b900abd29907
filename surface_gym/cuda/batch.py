"""Batches of environments on a CUDA device."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch

from surface_gym.config import REWARD, EnvConfig
from surface_gym.core import resets
from surface_gym.core.assembly import make_env_params
from surface_gym.cuda import kernels
from surface_gym.cuda.memory import interleave, make_device_state, send, to_device
from surface_gym.cuda.prefetch import Prefetch
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, ENTERED, TOUCHES, TURNS, WRONG
from surface_gym.physics.types import Array, Integers
from surface_gym.state import COMMON_OUTCOMES, NO_FAULT, OUT_OF_TIME, PATH_POINTS, RUNNING, SUCCESS

Tensors = dict[str, torch.Tensor]


class BaseCudaBatch(ABC):
    """Environments on a device, to place, step and observe; arrays are tensors on the device."""

    outcomes: tuple[str, ...]  # by the numbers of `outcome`
    options: tuple[str, ...]  # names of reset options
    author: str  # class name in error messages of compiled functions
    _surfaces: Any  # as `SurfaceState`, of tensors
    _episodes: Any  # has outcome, reward and fault of each environment, as tensors
    _step: kernels.Launch  # steps the environments in `_mask`, in the order of `_order`

    def __init__(self, num_envs: int, device: torch.device) -> None:
        self._device = device
        # (num_envs,) first fault of a compiled function
        self.first_fault = torch.zeros(num_envs, dtype=torch.int64, device=device)
        # (num_envs,) inputs of kernels: the environment of a thread, and whether to step it.
        self._order = torch.arange(num_envs, device=device)
        self._mask = torch.zeros(num_envs, dtype=torch.bool, device=device)

    @property
    def command(self) -> torch.Tensor:
        """Return the tensor of commands (num_envs, command size), which is filled before a step."""
        return self._surfaces.command

    @property
    def outcome(self) -> torch.Tensor:
        """Return the outcomes (num_envs,) of episodes, as indices into `outcomes`."""
        return self._episodes.outcome

    @property
    def reward(self) -> torch.Tensor:
        """Return the rewards (num_envs,) of the last control period."""
        return self._episodes.reward

    def step(self, mask: torch.Tensor) -> None:
        """Step environments in `mask` (num_envs,), or begin an episode if a start was placed."""
        self._mask.copy_(mask)
        self._step()
        fault = torch.where(mask, self._episodes.fault, NO_FAULT)
        torch.where(self.first_fault == NO_FAULT, fault, self.first_fault, out=self.first_fault)

    def truncate(self, late: torch.Tensor) -> None:
        """End the running episodes of the environments in the mask `late` (num_envs,)."""
        outcome = self.outcome
        outcome.masked_fill_(late & (outcome == RUNNING), OUT_OF_TIME)

    @property
    @abstractmethod
    def observation(self) -> torch.Tensor:
        """Return the observations (num_envs, ...)."""

    @abstractmethod
    def infos(self) -> Tensors:
        """Return copies of the infos (num_envs, ...), by name."""

    @abstractmethod
    def is_seeded(self, env_index: int) -> bool:
        """Return whether an environment has a generator."""

    @abstractmethod
    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Check reset options, one per environment, without drawing random numbers."""

    @abstractmethod
    def place_drawn(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        """Put the next start into each chosen environment (count,); `step` begins the episode.

        `generators` has new generators by environment index. `options` has one dict of reset
        options per chosen environment, or is empty.
        """

    @abstractmethod
    def place_next(self, mask: torch.Tensor) -> None:
        """Place new starts where `mask`, shape (num_envs,), is true. `step` begins the episodes."""

    def prepare_starts(self) -> None:
        """Prepare later starts; called after every control period."""
        return

    def close(self) -> None:
        """End the threads on the host."""
        return


SORT_EVERY = 8  # control periods


class CudaBatch(BaseCudaBatch):
    """The environments of `core.batch.Batch` on a device.

    Kernels are compiled when they are first called, which takes tens of seconds.
    """

    def __init__(self, config: EnvConfig, num_envs: int, device: torch.device) -> None:
        super().__init__(num_envs, device)
        self._config = config
        self._task = config.task
        self.outcomes = COMMON_OUTCOMES + self._task.outcomes
        self.options = self._task.options
        self.author = type(self._task).__name__
        line = config.chosen_line
        self._plan = resets.BodyPlan(
            self._task.parcels, partial(resets.place_in, config), 1, (line.rows, line.columns)
        )
        self._sizes = torch.from_numpy(self._plan.sizes).to(device)  # (bodies, 4) of the parcels
        params = to_device(make_env_params(config), device)
        self._bodies = to_device(self._plan.bodies, device)
        self._parcels: Any  # as `ParcelState`, of tensors
        self._surfaces, self._parcels = make_device_state(config, num_envs, device)
        self._episodes = self._parcels
        self.prefetch = Prefetch(self._task, self._make_rows, num_envs, device)
        self._periods = 0
        # Kernels are always called with the same arrays; only their content changes.
        state = (params, self._surfaces, self._parcels, self._bodies)
        self._step = kernels.Launch(
            kernels.step_kernel(config), (*state, self._order, self._mask), num_envs
        )
        rings = self.prefetch.rings, self.prefetch.starts_taken
        placed = (self._surfaces, self._parcels, *rings, self._mask)
        self._place = kernels.Launch(kernels.place_starts, placed, num_envs)

    @property
    def observation(self) -> torch.Tensor:
        return self._parcels.observation

    def infos(self) -> Tensors:
        parcels, task = self._parcels, self._task
        infos = {
            "is_success": parcels.outcome == SUCCESS,
            "outcome": parcels.outcome.clone(),
            "time": parcels.clock.clone(),
            "pose": parcels.truth[:, :3].clone(),
            "velocity": parcels.truth[:, 3:].clone(),
            "parcel": self._sizes[parcels.body],
            **{name: parcels.metrics[:, k].clone() for k, name in enumerate(task.metrics)},
        }
        return infos | {REWARD + n: parcels.terms[:, k].clone() for k, n in enumerate(task.terms)}

    def is_seeded(self, env_index: int) -> bool:
        return self.prefetch.is_seeded(env_index)

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        self._make_rows(np.full((len(options), self._task.draws), 0.5), options)

    def place_drawn(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        self.prefetch.refill(generators, chosen, options)
        mask = torch.zeros_like(self._mask)
        mask[send(chosen, self._device)] = True
        self.place_next(mask)

    def place_next(self, mask: torch.Tensor) -> None:
        self._mask.copy_(mask)
        self._place()

    def prepare_starts(self) -> None:
        self.prefetch.update()
        self._periods += 1
        if self._periods % SORT_EVERY == 0:
            self._sort()

    def close(self) -> None:
        self.prefetch.close()

    def _sort(self) -> None:
        """Sort environments by parcel, so that neighbouring threads have equally long loops."""
        if len(self._bodies.zone) > 1:
            self._order.copy_(torch.argsort(self._parcels.body, stable=True))

    def _make_rows(
        self, numbers: Array, options: Sequence[dict[str, Any]]
    ) -> tuple[resets.StartRows, Array]:
        """Make starts and paths (starts, PATH_POINTS or 0) from random numbers (starts, draws)."""
        config, count = self._config, len(numbers)
        start = resets.draw_starts(config, numbers, options)
        parcels = resets.each_parcel(start.parcel, count)
        bodies: Integers = self._plan.shared_bodies_of(parcels)
        if (bodies < 0).any():
            first = int(np.nonzero(bodies < 0)[0][0])
            raise ValueError(
                f"parcel must be one that the task draws where device is {str(self._device)!r}, "
                f"got {parcels.kinds[parcels.which[first]]!r}; a task with parcels=... draws it"
            )
        path = np.zeros((count, 0))
        if self._task.has_path:
            path = np.broadcast_to(
                resets.start_paths(self._task, start, count), (count, PATH_POINTS)
            )
        return resets.start_rows(self._task, start, parcels, bodies), path


# Arrays written by drawing an episode; the kernel initialises the others.
DRAWN_SURFACES = ("stiffness", "conditions")
DRAWN_STREAMS = (
    "time", "start", "body", "exit", "inlet", "order", "past", "arrivals", "coming", "due",
    "entered", "departed", "taken", "touches", "number", "present", "touched_at", "clock",
    "steps", "still", "waited", "obeys", "tally", "outcome", "correct", "results", "final",
    "next_place", "memory", "exit_memory", "pressing", "impulse", "squeeze",
)  # fmt: skip
TALLIED = {
    "entered": ENTERED,
    "correct": CORRECT,
    "wrong": WRONG,
    "touches": TOUCHES,
    "turns": TURNS,
}


class CudaStreamBatch(BaseCudaBatch):
    """The environments of `flow.batch.StreamBatch` on a device.

    The host draws the arrivals when an environment begins an episode. So the host waits for the
    device in each step, to learn which environments have ended. The wait costs little time.
    """

    def __init__(self, config: EnvConfig, num_envs: int, device: torch.device) -> None:
        super().__init__(num_envs, device)
        self._config = config
        self._task = task = config.stream_task
        self._host = StreamBatch(config, num_envs, compiles=False)
        self.outcomes, self.options = self._host.outcomes, self._host.options
        self.author = type(task).__name__
        self._capacity = kernels.stream_capacity(config, task.stream.kinds)
        self._params = to_device(self._host.params, device)
        self._stream_params = to_device(self._host.stream_params, device)
        self._surfaces = to_device(self._host.surfaces, device)
        self._parcels = to_device(self._host.parcels, device)
        self._episodes = to_device(self._host.streams, device)
        scratch = to_device(kernels.make_stream_scratch(self._capacity, task.rows), device)
        self._scratches = type(scratch)._make(interleave(values, num_envs) for values in scratch)
        self._step = kernels.Launch(kernels.stream_step_kernel(config), self._arguments(), num_envs)

    def _arguments(self) -> tuple[Any, ...]:
        bodies = to_device(self._host.bodies, self._device)
        params = (self._params, self._stream_params)
        state = (self._surfaces, self._parcels, bodies, self._episodes, self._scratches)
        return (*params, *state, self._order, self._mask)

    @property
    def observation(self) -> torch.Tensor:
        observation: torch.Tensor = self._parcels.observation
        return observation.reshape(len(self._mask), self._task.rows, -1)

    def infos(self) -> Tensors:
        streams, task = self._episodes, self._task
        numbers = torch.where(streams.present, streams.number, -1)
        infos = {
            "outcome": streams.outcome.clone(),
            "time": streams.clock.clone(),
            "parcels": numbers[:, : task.max_parcels],
            **{name: streams.tally[:, column].clone() for name, column in TALLIED.items()},
            "waiting": streams.due - streams.tally[:, ENTERED],
        }
        return infos | {REWARD + n: streams.terms[:, k].clone() for k, n in enumerate(task.terms)}

    def is_seeded(self, env_index: int) -> bool:
        return self._host.is_seeded(env_index)

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        self._host.check(options)
        for each in options:
            stream = each.get("stream", self._task.stream)
            if kernels.stream_capacity(self._config, stream.kinds) > self._capacity:
                raise ValueError(
                    f"stream must have no larger parcels than the environment draws, on device "
                    f"{str(self._device)!r}; got {stream.kinds}"
                )

    def place_drawn(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        for i, generator in generators.items():
            self._host.seed(i, generator)
        self._host.place_drawn(chosen, options)
        self._widen()
        self._send(chosen)
        self._step.set_arguments(self._arguments())

    def place_next(self, mask: torch.Tensor) -> None:
        chosen = np.nonzero(mask.cpu().numpy())[0]
        if len(chosen) > 0:
            self.place_drawn({}, chosen, ())

    def _widen(self) -> None:
        """Widen the arrays to the host's number of arrivals, and keep their values."""
        width = self._episodes.time.shape[1]
        if self._host.streams.time.shape[1] == width:
            return
        made = to_device(self._host.streams, self._device)
        wider = {
            name: new
            for name, new, old in zip(made._fields, made, self._episodes, strict=True)
            if new.shape != old.shape
        }
        for name, new in wider.items():
            new[:, :width] = getattr(self._episodes, name)
        self._episodes = self._episodes._replace(**wider)

    def _send(self, chosen: Integers) -> None:
        """Send new episodes of the chosen environments (count,) from the host to the device."""
        host, rows = self._host, self._task.rows
        env_indices = send(chosen, self._device)
        for state, source, names in (
            (self._episodes, host.streams, DRAWN_STREAMS),
            (self._surfaces, host.surfaces, DRAWN_SURFACES),
        ):
            for name in names:
                values = getattr(source, name)
                if len(values) == len(self._mask) and values.size:
                    getattr(state, name)[env_indices] = send(values[chosen], self._device)
        parcel_rows = (chosen[:, np.newaxis] * rows + np.arange(rows)).ravel()
        outcome = send(host.parcels.outcome[parcel_rows], self._device)
        self._parcels.outcome[send(parcel_rows, self._device)] = outcome
