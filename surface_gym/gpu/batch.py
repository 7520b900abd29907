"""A batch of lanes on a device: starts are placed on it, commands move it."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch

from surface_gym.batch.making import rules_of
from surface_gym.batch.placement import placement_in
from surface_gym.batch.sites import SitePlan
from surface_gym.batch.starts import Rows, parcels_of, path_of, rows_of, starts_of
from surface_gym.dynamics.types import Array, Integers
from surface_gym.gpu.driven import DeviceLanes
from surface_gym.gpu.kernel import move_kernel, place
from surface_gym.gpu.launch import Launch
from surface_gym.gpu.memory import make_memory, to_device
from surface_gym.gpu.passing import sent
from surface_gym.gpu.starts import Supply
from surface_gym.lanes.memory import COMMON_OUTCOMES, PATH_POINTS, SUCCESS
from surface_gym.settings import Settings

GROUPED_EVERY = 8  # control periods


class DeviceBatch(DeviceLanes):
    """Lanes of one environment, as `batch.batch.Batch` has them, on a device.

    Kernels are compiled when they are first called, which takes tens of seconds.

    Args:
        settings: of the environment, which `needs.check_settings` has passed.
        lanes: their number.
        device: where they are.

    Raises:
        ValueError: the task or the sensor lacks a compiled function.
    """

    def __init__(self, settings: Settings, lanes: int, device: torch.device) -> None:
        super().__init__(lanes, device)
        self._settings = settings
        self._task = settings.chosen_task
        self.outcomes = COMMON_OUTCOMES + self._task.outcomes
        self.options = self._task.options
        self.author = type(self._task).__name__
        plant = settings.chosen_plant
        self._plan = SitePlan(
            self._task.parcels, partial(placement_in, settings), 1, (plant.rows, plant.columns)
        )
        self._rules = to_device(rules_of(settings), device)
        self._sites = to_device(self._plan.sites, device)
        self._lanes: Any  # as `Lanes`, of tensors
        self._surfaces, self._lanes = make_memory(settings, lanes, device)
        self._episodes = self._lanes
        self.supply = Supply(self._task, self._lay_out, lanes, device)
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
            **{name: lanes.figures[:, k].clone() for k, name in enumerate(task.figures)},
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
        """Let neighbouring threads move parcels that are alike: they take as many turns in each
        loop, and threads that do not wait for those that do.
        """
        if len(self._sites.zone) > 1:
            self._order.copy_(torch.argsort(self._lanes.site, stable=True))

    def _lay_out(self, numbers: Array, options: Sequence[dict[str, Any]]) -> tuple[Rows, Array]:
        """Rows and paths (starts, PATH_POINTS or 0) of the starts that numbers (starts, draws)
        come to.

        Raises:
            ValueError: an option is not allowed, or a parcel is none that the task draws.
        """
        settings, count = self._settings, len(numbers)
        start = starts_of(settings, numbers, options)
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
