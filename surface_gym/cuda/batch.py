"""Batches of environments on a CUDA device."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch

from surface_gym.config import EnvConfig
from surface_gym.core.assembly import make_rules
from surface_gym.core.resets import (
    BodyPlan,
    StartRows,
    draw_starts,
    each_parcel,
    place_in,
    start_paths,
    start_rows,
)
from surface_gym.cuda.kernels import (
    Launch,
    make_scratch,
    move_flow_kernel,
    move_kernel,
    place,
    stream_capacity,
)
from surface_gym.cuda.memory import make_memory, sent, side_by_side, to_device
from surface_gym.cuda.prefetch import Prefetch
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import ENTERED, RIGHT, TOUCHES, TURNS, WRONG
from surface_gym.physics.types import Array, Integers
from surface_gym.state import COMMON_OUTCOMES, NO_FAULT, OUT_OF_TIME, PATH_POINTS, RUNNING, SUCCESS


class CudaEnvs(ABC):
    """Environments on a device that are started, stepped and observed; all arrays are tensors on
    it.

    Args:
        lanes: their number.
        device: where they are.
    """

    outcomes: tuple[str, ...]  # how an episode may stand
    options: tuple[str, ...]  # what `reset(options=...)` may fix
    author: str  # whose functions may have gone wrong
    _surfaces: Any  # as `Surfaces`, of tensors
    _episodes: Any  # what holds outcome, reward and fault of each lane, of tensors
    _move: Launch  # of what the mask says, in the order

    def __init__(self, lanes: int, device: torch.device) -> None:
        self._device = device
        # (lanes,) what a function was the first to do wrong
        self.first_fault = torch.zeros(lanes, dtype=torch.int64, device=device)
        # What kernels read of each call: (lanes,) which lane a thread is for, and who is meant.
        self._order = torch.arange(lanes, device=device)
        self._mask = torch.zeros(lanes, dtype=torch.bool, device=device)

    @property
    def command(self) -> torch.Tensor:
        """Return the commands (num_envs, command size), to write before a move."""
        command: torch.Tensor = self._surfaces.command
        return command

    @property
    def outcome(self) -> torch.Tensor:
        """Return the state (num_envs,) of each episode, an index into `outcomes`."""
        outcome: torch.Tensor = self._episodes.outcome
        return outcome

    @property
    def reward(self) -> torch.Tensor:
        """Return the rewards (num_envs,) of the last control period."""
        reward: torch.Tensor = self._episodes.reward
        return reward

    def move(self, mask: torch.Tensor) -> None:
        """Step the environments in the mask (num_envs,) by one control period, or begin those
        placed.
        """
        self._mask.copy_(mask)
        self._move()
        fault = torch.where(mask, self._episodes.fault, NO_FAULT)
        torch.where(self.first_fault == NO_FAULT, fault, self.first_fault, out=self.first_fault)

    def truncate(self, late: torch.Tensor) -> None:
        """End the episodes that still run of the environments in the mask (lanes,)."""
        outcome = self.outcome
        outcome.masked_fill_(late & (outcome == RUNNING), OUT_OF_TIME)

    @property
    @abstractmethod
    def observation(self) -> torch.Tensor:
        """Return the observations (num_envs, ...)."""

    @abstractmethod
    def told(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        """Return copies of the infos, (num_envs, ...) by name, and the terms of the reward."""

    @abstractmethod
    def is_seeded(self, lane: int) -> bool:
        """Return whether an environment has a generator."""

    @abstractmethod
    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Raise what `start` would for options of as many environments, and draw nothing."""

    @abstractmethod
    def start(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        """Put the next start on some environments; `move` begins it.

        Args:
            generators: that some lanes, by their number, draw their starts from anew.
            chosen: (count,) the lanes, all of which have a generator.
            options: of each of these; none at all: none has any.
        """

    @abstractmethod
    def place(self, mask: torch.Tensor) -> None:
        """Put the next start on each environment in the mask (num_envs,); `move` begins it."""

    @abstractmethod
    def follow(self) -> None:
        """Prepare later starts; called after every control period."""

    @abstractmethod
    def close(self) -> None:
        """Release what is held."""


GROUPED_EVERY = 8  # control periods


class CudaBatch(CudaEnvs):
    """The environments of `core.batch.Batch` on a device.

    Kernels are compiled when they are first called, which takes tens of seconds.

    Args:
        settings: of the environment, which `needs.check_settings` has passed.
        lanes: their number.
        device: where they are.

    Raises:
        ValueError: the task or the sensor lacks a compiled function.
    """

    def __init__(self, settings: EnvConfig, lanes: int, device: torch.device) -> None:
        super().__init__(lanes, device)
        self._settings = settings
        self._task = settings.task
        self.outcomes = COMMON_OUTCOMES + self._task.outcomes
        self.options = self._task.options
        self.author = type(self._task).__name__
        plant = settings.chosen_line
        self._plan = BodyPlan(
            self._task.parcels, partial(place_in, settings), 1, (plant.rows, plant.columns)
        )
        self._rules = to_device(make_rules(settings), device)
        self._sites = to_device(self._plan.bodies, device)
        self._lanes: Any  # as `Lanes`, of tensors
        self._surfaces, self._lanes = make_memory(settings, lanes, device)
        self._episodes = self._lanes
        self.supply = Prefetch(self._task, self._lay_out, lanes, device)
        self._periods = 0
        # What kernels are called with never changes but in its content.
        memory = (self._rules, self._surfaces, self._lanes, self._sites)
        supply = self.supply
        held = (self._surfaces, self._lanes, supply.starts, supply.taken)
        self._move = Launch(move_kernel(settings), (*memory, self._order, self._mask), lanes)
        self._place = Launch(place, (*held, self._mask), lanes)

    @property
    def observation(self) -> torch.Tensor:
        observation: torch.Tensor = self._lanes.observation
        return observation

    def told(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        lanes, task = self._lanes, self._task
        infos = {
            "is_success": lanes.outcome == SUCCESS,
            "outcome": lanes.outcome.clone(),
            "time": lanes.clock.clone(),
            "pose": lanes.truth[:, :3].clone(),
            "velocity": lanes.truth[:, 3:].clone(),
            **{name: lanes.metrics[:, k].clone() for k, name in enumerate(task.metrics)},
        }
        return infos, {name: lanes.terms[:, k].clone() for k, name in enumerate(task.terms)}

    def is_seeded(self, lane: int) -> bool:
        return self.supply.is_seeded(lane)

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        self._lay_out(np.full((len(options), self._task.draws), 0.5), options)

    def start(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        self.supply.renew(generators, chosen, options)
        mask = torch.zeros_like(self._mask)
        mask[sent(chosen, self._device)] = True
        self.place(mask)

    def place(self, mask: torch.Tensor) -> None:
        self._mask.copy_(mask)
        self._place()

    def follow(self) -> None:
        self.supply.follow()
        self._periods += 1
        if self._periods % GROUPED_EVERY == 0:
            self._group()

    def close(self) -> None:
        self.supply.close()

    def _group(self) -> None:
        """Sort environments by parcel, so that neighbouring threads take as many turns in each
        loop.
        """
        if len(self._sites.zone) > 1:
            self._order.copy_(torch.argsort(self._lanes.site, stable=True))

    def _lay_out(
        self, numbers: Array, options: Sequence[dict[str, Any]]
    ) -> tuple[StartRows, Array]:
        """Return rows and paths (starts, PATH_POINTS or 0) of the starts from numbers (starts,
        draws).

        Raises:
            ValueError: an option is not allowed, or a parcel is none that the task draws.
        """
        settings, count = self._settings, len(numbers)
        start = draw_starts(settings, numbers, options)
        parcels = each_parcel(start.parcel, count)
        sites: Integers = self._plan.shared_bodies_of(parcels)
        if (sites < 0).any():
            first = int(np.nonzero(sites < 0)[0][0])
            raise ValueError(
                f"parcel must be one that the task draws where device is {str(self._device)!r}, "
                f"got {parcels.kinds[parcels.which[first]]!r}; a task with parcels=... draws it"
            )
        path = np.zeros((count, 0))
        if self._task.has_path:
            path = np.broadcast_to(start_paths(self._task, start, count), (count, PATH_POINTS))
        return start_rows(self._task, start, parcels, sites), path


# What drawing an episode writes, by the tuple that holds it; the kernel begins the rest.
OF_SURFACES = ("stiffness", "conditions")
OF_FLOWS = (
    "time", "start", "site", "exit", "arrivals", "coming", "due", "entered", "left", "taken",
    "touches", "number", "present", "touched_at", "clock", "steps", "still", "waited", "obeys",
    "tally", "outcome",
)  # fmt: skip


class CudaStreamBatch(CudaEnvs):
    """The environments of `flow.batch.StreamBatch` on a device.

    Episodes are long, so what is to come is drawn by the host when a lane begins, for which it
    waits to know which lanes have ended.

    Args:
        settings: of the environment, whose sensor has no noise.
        lanes: number of surfaces.
        device: where they are.

    Raises:
        ValueError: the sensor lacks a compiled function.
    """

    def __init__(self, settings: EnvConfig, lanes: int, device: torch.device) -> None:
        super().__init__(lanes, device)
        self._settings = settings
        self._host = StreamBatch(settings, lanes, compiles=False)
        self.outcomes, self.options = self._host.outcomes, self._host.options
        self.author = type(settings.task).__name__
        self._capacity = stream_capacity(settings, settings.stream_task.stream.kinds)
        self._rules = to_device(self._host.rules, device)
        self._params = to_device(self._host.params, device)
        self._surfaces = to_device(self._host.surfaces, device)
        self._lanes = to_device(self._host.parcels, device)
        self._episodes = to_device(self._host.streams, device)
        one = to_device(make_scratch(self._capacity, settings.stream_task.rows), device)
        self._scratches = type(one)._make(side_by_side(values, lanes) for values in one)
        self._move = Launch(move_flow_kernel(settings), self._arguments(), lanes)

    def _arguments(self) -> tuple[Any, ...]:
        sites = to_device(self._host.bodies, self._device)
        rules = (self._rules, self._params)
        memory = (self._surfaces, self._lanes, sites, self._episodes, self._scratches)
        return (*rules, *memory, self._order, self._mask)

    @property
    def observation(self) -> torch.Tensor:
        seen: torch.Tensor = self._lanes.observation
        return seen.reshape(len(self._mask), self._settings.stream_task.rows, -1)

    def told(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        flows = self._episodes
        there = torch.where(flows.present, flows.number, -1)[
            :, : self._settings.stream_task.max_parcels
        ]
        tallied = {"entered": ENTERED, "right": RIGHT, "wrong": WRONG, "touches": TOUCHES,
                   "turns": TURNS}  # fmt: skip
        infos = {
            "outcome": flows.outcome.clone(),
            "time": flows.clock.clone(),
            "parcels": there,
            **{name: flows.tally[:, place].clone() for name, place in tallied.items()},
            "waiting": flows.due - flows.coming,
        }
        return infos, {
            name: flows.terms[:, k].clone() for k, name in enumerate(self._settings.task.terms)
        }

    def is_seeded(self, lane: int) -> bool:
        return self._host.is_seeded(lane)

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        self._host.check(options)
        for each in options:
            stream = each.get("stream", self._settings.stream_task.stream)
            if stream_capacity(self._settings, stream.kinds) > self._capacity:
                raise ValueError(
                    f"stream must have parcels no larger than those of the environment's where "
                    f"device is {str(self._device)!r}, got {stream.kinds}"
                )

    def start(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        for lane, generator in generators.items():
            self._host.seed(lane, generator)
        self._host.place_drawn(chosen, options)
        self._make_room()
        self._send(chosen)
        self._move.call_with(self._arguments())

    def place(self, mask: torch.Tensor) -> None:
        chosen = np.nonzero(mask.cpu().numpy())[0]
        if len(chosen) > 0:
            self.start({}, chosen, ())

    def follow(self) -> None:
        """Prepare later starts; called after every control period."""

    def close(self) -> None:
        """Release what is held."""

    def _make_room(self) -> None:
        """Widen the arrays to as many arrivals as the host's have, and keep what they hold."""
        had = self._episodes.time.shape[1]
        if self._host.streams.time.shape[1] == had:
            return
        made = to_device(self._host.streams, self._device)
        wider = {
            name: new
            for name, new, old in zip(made._fields, made, self._episodes, strict=True)
            if new.shape != old.shape
        }
        for name, new in wider.items():
            new[:, :had] = getattr(self._episodes, name)
        self._episodes = self._episodes._replace(**wider)

    def _send(self, chosen: Integers) -> None:
        """Send what was drawn for the chosen environments (count,)."""
        host, lanes = self._host, len(self._mask)
        where = sent(chosen, self._device)
        drawn: list[tuple[Any, Any, str]] = [
            (self._episodes, host.streams, name) for name in OF_FLOWS
        ]
        drawn += [(self._surfaces, host.surfaces, name) for name in OF_SURFACES]
        for ours, theirs, name in drawn:
            values = getattr(theirs, name)
            if len(values) == lanes:
                getattr(ours, name)[where] = sent(values[chosen], self._device)
        rows = self._settings.stream_task.rows
        of_parcels = (chosen[:, np.newaxis] * rows + np.arange(rows)).ravel()
        outcome = sent(host.parcels.outcome[of_parcels], self._device)
        self._lanes.outcome[sent(of_parcels, self._device)] = outcome
