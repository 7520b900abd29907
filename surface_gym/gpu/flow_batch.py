"""A batch of flows on a device: the host draws their streams, the device moves them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from surface_gym.dynamics.types import Integers
from surface_gym.flow.episodes import FlowEpisodes
from surface_gym.flow.memory import ENTERED, RIGHT, TOUCHES, TURNS, WRONG
from surface_gym.flow.rewards import TERMS
from surface_gym.flow.settings import FlowSettings
from surface_gym.gpu.driven import DeviceLanes
from surface_gym.gpu.flow_kernel import capacity_of, make_scratch, move_flow_kernel
from surface_gym.gpu.launch import Launch
from surface_gym.gpu.memory import side_by_side, to_device
from surface_gym.gpu.passing import sent

# What drawing an episode writes, by the tuple that holds it; the kernel begins the rest.
OF_SURFACES = ("stiffness", "conditions")
OF_FLOWS = (
    "time", "start", "site", "exit", "arrivals", "coming", "due", "entered", "left", "taken",
    "touches", "number", "present", "touched_at", "clock", "steps", "still", "waited", "obeys",
    "tally", "outcome",
)  # fmt: skip


class DeviceFlowBatch(DeviceLanes):
    """Flows of one environment, as `flow.batch.FlowBatch` has them, on a device.

    Episodes are long, so what is to come is drawn by the host when a lane begins, for which it
    waits to know which lanes have ended.

    Args:
        settings: of the environment, whose sensor has no noise.
        lanes: number of surfaces.
        device: where they are.

    Raises:
        ValueError: the sensor lacks a compiled function.
    """

    def __init__(self, settings: FlowSettings, lanes: int, device: torch.device) -> None:
        super().__init__(lanes, device)
        self._settings = settings
        self._host = FlowEpisodes(settings, lanes)
        self.outcomes, self.options = self._host.outcomes, self._host.options
        self.author = type(settings.sensors).__name__
        self._capacity = capacity_of(settings, settings.stream.kinds)
        self._rules = to_device(self._host.rules, device)
        self._flow_rules = to_device(self._host.flow_rules, device)
        self._surfaces = to_device(self._host.surfaces, device)
        self._lanes = to_device(self._host.lanes, device)
        self._episodes = to_device(self._host.flows, device)
        one = to_device(make_scratch(self._capacity, settings.rows), device)
        self._scratches = type(one)._make(side_by_side(values, lanes) for values in one)
        self._move = Launch(move_flow_kernel(settings), self._arguments(), lanes)

    def _arguments(self) -> tuple[Any, ...]:
        sites = to_device(self._host.sites, self._device)
        rules = (self._rules, self._flow_rules)
        memory = (self._surfaces, self._lanes, sites, self._episodes, self._scratches)
        return (*rules, *memory, self._order, self._mask)

    @property
    def observation(self) -> torch.Tensor:
        seen: torch.Tensor = self._lanes.observation
        return seen.reshape(len(self._mask), self._settings.rows, -1)

    def told(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        flows = self._episodes
        there = torch.where(flows.present, flows.number, -1)[:, : self._settings.places]
        tallied = {"entered": ENTERED, "right": RIGHT, "wrong": WRONG, "touches": TOUCHES,
                   "turns": TURNS}  # fmt: skip
        infos = {
            "outcome": flows.outcome.clone(),
            "time": flows.clock.clone(),
            "parcels": there,
            **{name: flows.tally[:, place].clone() for name, place in tallied.items()},
            "waiting": flows.due - flows.coming,
        }
        return infos, {name: flows.terms[:, k].clone() for k, name in enumerate(TERMS)}

    def is_seeded(self, lane: int) -> bool:
        return self._host.is_seeded(lane)

    def check(self, options: Sequence[dict[str, Any]]) -> None:
        self._host.check(options)
        for each in options:
            stream = each.get("stream", self._settings.stream)
            if capacity_of(self._settings, stream.kinds) > self._capacity:
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
        self._host.place(chosen, options)
        self._make_room()
        self._send(chosen)
        self._move.call_with(self._arguments())

    def place(self, mask: torch.Tensor) -> None:
        chosen = np.nonzero(mask.cpu().numpy())[0]
        if len(chosen) > 0:
            self.start({}, chosen, ())

    def follow(self) -> None:
        """Nothing is drawn ahead."""

    def close(self) -> None:
        """Nothing is held."""

    def _make_room(self) -> None:
        """As many columns for arrivals as the host's memory has; what lanes have is kept."""
        had = self._episodes.time.shape[1]
        if self._host.flows.time.shape[1] == had:
            return
        made = to_device(self._host.flows, self._device)
        wider = {
            name: new
            for name, new, old in zip(made._fields, made, self._episodes, strict=True)
            if new.shape != old.shape
        }
        for name, new in wider.items():
            new[:, :had] = getattr(self._episodes, name)
        self._episodes = self._episodes._replace(**wider)

    def _send(self, chosen: Integers) -> None:
        """What was drawn for the chosen lanes (count,)."""
        host, lanes = self._host, len(self._mask)
        where = sent(chosen, self._device)
        drawn: list[tuple[Any, Any, str]] = [
            (self._episodes, host.flows, name) for name in OF_FLOWS
        ]
        drawn += [(self._surfaces, host.surfaces, name) for name in OF_SURFACES]
        for ours, theirs, name in drawn:
            values = getattr(theirs, name)
            if len(values) == lanes:
                getattr(ours, name)[where] = sent(values[chosen], self._device)
        rows = self._settings.rows
        of_parcels = (chosen[:, np.newaxis] * rows + np.arange(rows)).ravel()
        outcome = sent(host.lanes.outcome[of_parcels], self._device)
        self._lanes.outcome[sent(of_parcels, self._device)] = outcome
