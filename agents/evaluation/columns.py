"""The columns of each task's table, beside the success rates."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..tasks import find_task, kind_of
from .sorting import (
    minimum_speed,
    parcels_an_hour,
    share_sorted,
    touched,
    worst_time,
)
from .summary import Summary


@dataclass(frozen=True)
class Column:
    """A column of a task's table beside the success rates."""

    name: str
    label: str
    meaning: str
    value: Callable[[Summary, Summary], float]  # of a contender and of the fixed layout; nan: none
    form: str = ".2f"
    scale: float = 1.0  # to the label's unit
    every_start: bool = False  # it needs all of both boxes, and is left out where some are missing


def _median(name: str) -> Callable[[Summary, Summary], float]:
    return lambda summary, _: float(np.median(summary.figure(name)))


def _high(name: str) -> Callable[[Summary, Summary], float]:
    return lambda summary, _: float(np.quantile(summary.figure(name), 0.9))


TIME = Column(
    "time", "time [s]", "of an episode, median over starts",
    lambda summary, _: float(np.median(summary.time)),
)  # fmt: skip


def _of_box(parcel: str) -> tuple[Column, ...]:
    return (
        Column(
            f"minimum_speed_{parcel}",
            f"minimum {parcel} [m/s]",
            f"entry speed from which on every start of every seed is sorted, {parcel}-box",
            lambda summary, _: minimum_speed(summary, parcel),
            every_start=True,
        ),
        Column(
            f"success_{parcel}",
            f"success {parcel}",
            f"share of the {parcel}-box's starts",
            lambda summary, _: share_sorted(summary, parcel),
            ".3f",
            every_start=True,
        ),
        Column(
            f"time_{parcel}",
            f"time {parcel}",
            "greatest time to sort over the fixed layout's, at the speeds that one sorts at",
            lambda summary, fixed: worst_time(summary, fixed, parcel),
            ".3f",
            every_start=True,
        ),
    )


_COLUMNS: dict[str, tuple[Column, ...]] = {
    "sort": (
        *_of_box("S"),
        *_of_box("B"),
        Column("columns", "columns", "of the zone that a parcel sorted touched, on average",
               lambda summary, _: touched(summary), ".1f"),
        Column("parcels_an_hour", "parcels/h",
               "an hour's parcels, each alone on the surface, by the mean time of those sorted",
               lambda summary, _: parcels_an_hour(summary), ".0f"),
    ),
    "slow": (
        Column("ratio_error", "error median", "of the ratio of exit and entry speed",
               _median("ratio_error"), ".4f"),
        Column("ratio_error_90", "error 90 %", "nine in ten are better", _high("ratio_error"),
               ".4f"),
    ),
    "stop": (
        Column("stop_error", "error median [mm]", "of the place of rest", _median("stop_error"),
               ".2f", 1e3),
        Column("stop_error_90", "error 90 % [mm]", "nine in ten are better", _high("stop_error"),
               ".2f", 1e3),
    ),
    "track": (
        Column("rms_error", "rms error [mm]", "off the path, median over starts",
               _median("rms_error"), ".1f", 1e3),
        Column("speed_error", "speed error [m/s]", "rms over an episode, median over starts",
               _median("speed_error"), ".3f"),
    ),
    "orient": (
        Column("angle_error", "error median [deg]", "of the angle on leaving",
               _median("angle_error"), ".2f", 180.0 / np.pi),
        Column("angle_error_90", "error 90 % [deg]", "nine in ten are better",
               _high("angle_error"), ".2f", 180.0 / np.pi),
    ),
}  # fmt: skip


def columns_of(task: str) -> tuple[Column, ...]:
    """The columns of a task's table, by its name; of one's own, what its figures come to."""
    kind = kind_of(task)
    if kind in _COLUMNS:
        return _COLUMNS[kind]
    own = [
        Column(
            figure + part, f"{figure} {part or 'median'}".replace("_", " "), meaning, value(figure)
        )
        for figure in find_task(task).figures
        for part, meaning, value in (
            ("", "its size, median over starts", _median),
            ("_90", "nine in ten are smaller", _high),
        )
    ]
    return (*own, TIME)
