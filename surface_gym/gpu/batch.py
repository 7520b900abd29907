"""A batch of lanes on a device: starts are placed on it, commands move it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from surface_gym.batch.making import rules_of
from surface_gym.batch.placement import Placement, placement_of
from surface_gym.batch.sites import SitePlan
from surface_gym.batch.starts import Rows, parcels_of, path_of, rows_of, starts_of
from surface_gym.dynamics.types import Array, Integers
from surface_gym.gpu.kernel import move_kernel, place
from surface_gym.gpu.launch import Launch
from surface_gym.gpu.memory import make_memory, to_device
from surface_gym.gpu.starts import Supply
from surface_gym.lanes.memory import COMMON_OUTCOMES, PATH_POINTS, SOUND, SUCCESS
from surface_gym.parcel import Parcel
from surface_gym.settings import Settings
from surface_gym.tasks.start import Draw

GROUPED_EVERY = 8  # control periods


class DeviceBatch:
    """Lanes of one environment, as `batch.batch.Batch` has them, on a device; `DeviceDriven` says
    what its methods do.

    Kernels are compiled when they are first called, which takes tens of seconds.

    Args:
        settings: of the environment, which `needs.check_settings` has passed.
        lanes: their number.
        device: where they are.

    Raises:
        ValueError: the task or the sensor lacks a compiled function.
    """

    def __init__(self, settings: Settings, lanes: int, device: torch.device) -> None:
        self._settings = settings
        self._task = settings.chosen_task
        self.outcomes = COMMON_OUTCOMES + self._task.outcomes
        self.options = self._task.options
        self.author = type(self._task).__name__
        self._device = device
        plant = settings.chosen_plant
        self._plan = SitePlan(self._task.parcels, self._placement, 1, (plant.rows, plant.columns))
        self._rules = to_device(rules_of(settings), device)
        self._sites = to_device(self._plan.sites, device)
        self._surfaces: Any  # as `Surfaces`, of tensors
        self._lanes: Any  # as `Lanes`, of tensors
        self._surfaces, self._lanes = make_memory(settings, lanes, device)
        self.supply = Supply(self._task, self._lay_out, lanes, device)
        self._periods = 0
        # (lanes,) which lane each thread moves
        self._order = torch.arange(lanes, device=device)
        # (lanes,) what a function was the first to do wrong
        self.first_fault = torch.zeros(lanes, dtype=torch.int64, device=device)
        self._mask = torch.zeros(lanes, dtype=torch.bool, device=device)  # that kernels read
        # What kernels are called with never changes but in its content.
        memory = (self._rules, self._surfaces, self._lanes, self._sites)
        supply = self.supply
        held = (self._surfaces, self._lanes, supply.starts, supply.taken)
        self._move = Launch(move_kernel(settings), (*memory, self._order, self._mask), lanes)
        self._place = Launch(place, (*held, self._mask), lanes)

    @property
    def command(self) -> torch.Tensor:
        command: torch.Tensor = self._surfaces.command
        return command

    @property
    def outcome(self) -> torch.Tensor:
        outcome: torch.Tensor = self._lanes.outcome
        return outcome

    @property
    def observation(self) -> torch.Tensor:
        observation: torch.Tensor = self._lanes.observation
        return observation

    @property
    def reward(self) -> torch.Tensor:
        reward: torch.Tensor = self._lanes.reward
        return reward

    def told(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        lanes, task = self._lanes, self._task
        infos = {
            "is_success": lanes.outcome == SUCCESS,
            "outcome": lanes.outcome.clone(),
            "time": lanes.clock.clone(),
            "pose": lanes.truth[:, :3].clone(),
            "velocity": lanes.truth[:, 3:].clone(),
            **{name: lanes.figures[:, k].clone() for k, name in enumerate(task.figures)},
        }
        return infos, {name: lanes.terms[:, k].clone() for k, name in enumerate(task.terms)}

    def is_seeded(self, lane: int) -> bool:
        return self.supply.is_seeded(lane)

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        self._lay_out(np.full((len(options), self._task.draws), 0.5), options)

    def prepare(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        self.supply.renew(generators, chosen, options)

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

    def move(self, mask: torch.Tensor) -> None:
        self._mask.copy_(mask)
        self._move()
        fault = torch.where(mask, self._lanes.fault, SOUND)
        torch.where(self.first_fault == SOUND, fault, self.first_fault, out=self.first_fault)

    def _group(self) -> None:
        """Let neighbouring threads move parcels that are alike: they take as many turns in each
        loop, and threads that do not wait for those that do.
        """
        if len(self._sites.zone) > 1:
            self._order.copy_(torch.argsort(self._lanes.site, stable=True))

    def _placement(self, parcel: Parcel) -> Placement:
        settings = self._settings
        stuck = tuple(settings.actuators.stuck)
        return placement_of(parcel, settings.chosen_plant, settings.zone, stuck)

    def _lay_out(self, numbers: Array, options: Sequence[dict[str, Any]]) -> tuple[Rows, Array]:
        """Rows and paths (starts, PATH_POINTS or 0) of the starts that numbers (starts, draws)
        come to.

        Raises:
            ValueError: an option is not allowed, or a parcel is none that the task draws.
        """
        settings, count = self._settings, len(numbers)
        draw = Draw(numbers, options, settings.chosen_plant, settings.zone)
        start = starts_of(self._task, draw)
        parcels = parcels_of(start.parcel, count)
        sites: Integers = self._plan.shared_sites_of(parcels)
        if (sites < 0).any():
            first = int(np.nonzero(sites < 0)[0][0])
            raise ValueError(
                f"parcel must be one that the task draws where device is {str(self._device)!r}, "
                f"got {parcels.kinds[parcels.which[first]]!r}; a task with parcels=... draws it"
            )
        path = np.zeros((count, 0))
        if self._task.has_path:
            path = np.broadcast_to(path_of(self._task, start, count), (count, PATH_POINTS))
        return rows_of(self._task, start, parcels, sites), path
