"""Parcels begin by imitating a rule: choices drawn at random would brake everybody to rest."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.features import PRESENT, WAITS
from surface_gym.state import RUNNING

from .practice import MIXES, SPEEDS, densest, practice_settings
from .reservation import Reservation
from .seat_policy import SeatPolicy
from .seats import SeatActions, seat_rows

SPEED_STEP = 0.1  # [m/s] between the streams that are shown
LANES = 8  # of each stream
LOADS = (1.0, 1.0, 1.0, 1.0, 0.6, 0.5, 0.4, 0.3)  # [-] of the densest stream, lane by lane
MARGIN = 0.008  # [m] that the ways shown keep clear
SHOWN = 0.8  # [-] of an episode's time
BATCH = 4096  # of a gradient step; half of them parcels at the gate, of which there are fewer
LEARNING_RATE = 1e-3  # at the start; it falls to 0

Rows = NDArray[np.float32]
Choices = NDArray[np.int64]


def demonstrations(control_period: float, seed: int) -> tuple[Rows, Choices]:
    """What seats saw (samples, features) and said (samples, 3) under a reservation."""
    seen, said = [], []
    base = practice_settings(control_period)
    speeds = np.arange(SPEEDS[0], SPEEDS[1] + 1e-9, SPEED_STEP)
    for number, speed in enumerate(speeds.round(3).tolist()):
        for mix, parcels in enumerate(MIXES):
            settings = replace(base, stream=densest(speed, parcels), duration=SHOWN * base.duration)
            rule, actions = Reservation(settings, margin=MARGIN), settings.flow_actions
            mirror = SeatActions(settings)
            batch = FlowBatch(settings, LANES)
            for lane in range(LANES):
                batch.seed(lane, np.random.default_rng((seed, number, mix, lane)))
            streams = [densest(speed, parcels, load) for load in LOADS]
            batch.start(np.arange(LANES), [{"stream": stream} for stream in streams])
            state = None
            while (batch.outcome == RUNNING).any():
                tables = batch.observation.copy()
                action, state = rule.predict(tables, state)
                there = tables[..., PRESENT] > 0.5
                seen.append(seat_rows(tables)[there])
                said.append(mirror.said(tables, action)[there])
                batch.advance(actions.commands(action, LANES))
    return np.concatenate(seen), np.concatenate(said)


def imitate(policy: SeatPolicy, seen: Rows, said: Choices, epochs: int, seed: int) -> None:
    """Make a policy say what was said, by the likelihood of the choices that count.

    Args:
        policy: to be made so.
        seen: (samples, features).
        said: (samples, 3).
        epochs: passes over the samples.
        seed: of the draws.
    """
    generator = torch.Generator().manual_seed(seed)
    observations, choices = torch.from_numpy(seen), torch.from_numpy(said)
    waits = observations[:, WAITS] > 0.5
    groups = [torch.nonzero(part)[:, 0] for part in (waits, ~waits)]
    optimiser = torch.optim.Adam(policy.parameters(), LEARNING_RATE)
    steps = epochs * (len(seen) // BATCH)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = LEARNING_RATE * (1.0 - step / steps)
        chosen = torch.cat(
            [
                group[torch.randint(len(group), (BATCH // 2,), generator=generator)]
                for group in groups
            ]
        )
        _, likelihood, _ = policy.evaluate_actions(observations[chosen], choices[chosen])
        optimiser.zero_grad()
        (-likelihood.mean()).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
