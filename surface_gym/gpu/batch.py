"""A batch of lanes on a device: starts are placed on it, commands move it."""

from collections.abc import Sequence
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
from surface_gym.lanes.memory import COMMON_OUTCOMES, PATH_POINTS, SOUND
from surface_gym.parcel import Parcel
from surface_gym.settings import Settings
from surface_gym.tasks.start import Draw


class DeviceBatch:
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
        self.settings = settings
        self.task = settings.chosen_task
        self.outcomes = COMMON_OUTCOMES + self.task.outcomes
        self.device = device
        plant = settings.chosen_plant
        self._plan = SitePlan(self.task.parcels, self._placement, 1, (plant.rows, plant.columns))
        self._rules = to_device(rules_of(settings), device)
        self._sites = to_device(self._plan.sites, device)
        self.surfaces: Any  # as `Surfaces`, of tensors
        self.lanes: Any  # as `Lanes`, of tensors
        self.surfaces, self.lanes = make_memory(settings, lanes, device)
        self.supply = Supply(self.task, self._lay_out, lanes, device)
        # (lanes,) which lane each thread moves
        self._order = torch.arange(lanes, device=device)
        # (lanes,) what a function was the first to do wrong
        self.first_fault = torch.zeros(lanes, dtype=torch.int64, device=device)
        self._mask = torch.zeros(lanes, dtype=torch.bool, device=device)  # that kernels read
        # What kernels are called with never changes but in its content.
        memory = (self._rules, self.surfaces, self.lanes, self._sites)
        supply = self.supply
        held = (self.surfaces, self.lanes, supply.starts, supply.taken)
        self._move = Launch(move_kernel(settings), (*memory, self._order, self._mask), lanes)
        self._place = Launch(place, (*held, self._mask), lanes)

    @property
    def options(self) -> tuple[str, ...]:
        """What `reset(options=...)` may fix."""
        return self.task.options

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        """Raise what `start` would for options of as many lanes, and draw nothing."""
        self._lay_out(np.full((len(options), self.task.draws), 0.5), options)

    def place(self, mask: torch.Tensor) -> None:
        """Put the next of its starts on each lane in the mask (lanes,); `move` begins it."""
        self._mask.copy_(mask)
        self._place()

    def move(self, mask: torch.Tensor) -> None:
        """Move the lanes in the mask (lanes,) over one control period, or begin those placed."""
        self._mask.copy_(mask)
        self._move()
        fault = torch.where(mask, self.lanes.fault, SOUND)
        torch.where(self.first_fault == SOUND, fault, self.first_fault, out=self.first_fault)

    def group(self) -> None:
        """Let neighbouring threads move parcels that are alike: they take as many turns in each
        loop, and threads that do not wait for those that do. To call now and then, as parcels
        change.
        """
        if len(self._sites.zone) > 1:
            self._order.copy_(torch.argsort(self.lanes.site, stable=True))

    def _placement(self, parcel: Parcel) -> Placement:
        settings = self.settings
        stuck = tuple(settings.actuators.stuck)
        return placement_of(parcel, settings.chosen_plant, settings.zone, stuck)

    def _lay_out(self, numbers: Array, options: Sequence[dict[str, Any]]) -> tuple[Rows, Array]:
        """Rows and paths (starts, PATH_POINTS or 0) of the starts that numbers (starts, draws)
        come to.

        Raises:
            ValueError: an option is not allowed, or a parcel is none that the task draws.
        """
        settings, count = self.settings, len(numbers)
        draw = Draw(numbers, options, settings.chosen_plant, settings.zone)
        start = starts_of(self.task, draw)
        parcels = parcels_of(start.parcel, count)
        sites: Integers = self._plan.shared_sites_of(parcels)
        if (sites < 0).any():
            first = int(np.nonzero(sites < 0)[0][0])
            raise ValueError(
                f"parcel must be one that the task draws where device is {str(self.device)!r}, "
                f"got {parcels.kinds[parcels.which[first]]!r}; a task with parcels=... draws it"
            )
        path = np.zeros((count, 0))
        if self.task.has_path:
            path = np.broadcast_to(path_of(self.task, start, count), (count, PATH_POINTS))
        return rows_of(self.task, start, parcels, sites), path
