"""Logs for tests: of hidden surfaces, and as files; and an estimate."""

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import surface_gym as sg
from benchmarks.identification import HiddenSurface, Recording, record
from surface_gym.lines import Line, Site
from surface_gym.machine import messages as ms
from surface_gym.machine.log import LoggedSurface, LogWriter, MachineLog

HIDDEN = HiddenSurface(0.42, 0.014, 0.008, 0.05, 0.07, 0.015, 0.012, -0.01)
BOX = sg.Parcel(sg.Rectangle(0.25, 0.25))
SHAPE = (4, 16)  # of the widest zone
SURFACE = LoggedSurface.of_line(Line(), 0.05, SHAPE)
SITE = Site(Line().site(BOX.base).rotor, (9, 2, 3, 16))

ESTIMATE = sg.Estimate(
    values={"mu_max": 0.42, "mu_min": 0.013, "quarter_turn": 0.08, "latency": 0.01},
    intervals={
        "mu_max": (0.41, 0.43), "mu_min": (-math.inf, math.inf), "quarter_turn": (0.07, 0.09),
        "latency": (0.009, 0.011),
    },
    correlations=((1.0, 0.0, 0.0, 0.0),) * 4,
    correlated=("mu_max", "mu_min", "quarter_turn", "latency"),
    inseparable=(("mu_min", "tilt"),),
    unknown=("mu_min",),
    misfit=1.7,
    is_explained=False,
    misfits=(1.0, 2.4),
    frames=120,
    noise=(0.002, 0.01),
    delay=0.03,
    unused={"parcel is still on the surface": 1},
)  # fmt: skip


@lru_cache(maxsize=8)
def recorded(seed: int = 0, stiffness: float = 0.0, **given: Any) -> MachineLog:
    """A log of a hidden surface; `given` are fields of `Recording`."""
    recording = Recording(**{"runs": 12, "seconds": 1.2, **given})
    return record(replace(HIDDEN, stiffness=stiffness), recording, np.random.default_rng(seed))


def write_log(file: Path, late: Any = 0.03, parcels: int = 2, clock: float = 0.0) -> Path:
    """Write a log of parcels that roll on; `late` [s] is a number, or a function of the time.

    `clock` [s] is what the machine's clock is ahead.
    """
    log = LogWriter(file, SURFACE)
    now = 100.0
    for number in range(parcels):
        log.write_site(now, SITE)
        entry = ms.ParcelEntry(
            number, now + clock, BOX, (0.2, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,)
        )  # fmt: skip
        log.write(now, "in", ms.to_fields(entry))
        log.write(now + 0.001, "out", ms.axes_to_fields(number, np.full(SHAPE, 0.5 * number)))
        answer = ms.AxesAcknowledgement(number, now + 0.002 + clock)
        log.write(now + 0.003, "in", ms.to_fields(answer))
        for k in range(50):
            taken = now + 0.02 * (k + 1)
            delay = late(taken) if callable(late) else late
            frame = ms.Frame(taken + clock, number, (0.2 + 0.02 * (k + 1), 1.0, 0.0))
            log.write(taken + delay, "in", ms.to_fields(frame))
        now += 2.0
        log.write(now, "in", ms.to_fields(ms.ParcelDeparture(number, "success")))
    log.close()
    return file
