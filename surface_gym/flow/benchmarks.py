"""Streams on which controllers of stream tasks are compared."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from surface_gym.flow.arrivals import Poisson, Steady
from surface_gym.flow.exits import Exit, Exits
from surface_gym.flow.stream import Stream
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera
from surface_gym.tasks.benchmark import (
    ENTRANCE,
    KINDS,
    STAY,
    TOUCHES,
    Offer,
    ResultColumn,
    StreamBenchmark,
    share_column,
)

SPEEDS = (1.0, 1.5, 2.0)  # [m/s]
BOXES = ("S", "B")
MIXES = {"S": ("S",), "S and B": BOXES}  # parcels with equal odds, by name
GROUPS = ("sides", "chutes")  # groups of exits; the first is the default
SIX = tuple(np.radians([0.0, 45.0, -45.0, 90.0, 80.0, -80.0]).tolist())  # orientations

FEW, SEVERAL = 0.05, 0.1  # [-] allowed touches per delivery with imperfect models, and in the lab
SIZES = tuple(
    Parcel(Rectangle(*each))
    for each in ((0.2, 0.2), (0.25, 0.3), (0.3, 0.2), (0.35, 0.35), (0.4, 0.3), (0.45, 0.45))
)
STRAIGHT = Exit("straight", 0)
STAGGERED = Exits(
    (
        Exit("left 1", 1, 0.6, 2.0), Exit("right 1", -1, 1.0, 2.6), Exit("left 2", 1, 3.0, 4.0),
        Exit("right 2", -1, 4.0, 5.5), STRAIGHT,
    )
)  # fmt: skip
THREE_LEFT = Exits(
    (
        Exit("left 1", 1, 0.5, 1.8), Exit("left 2", 1, 2.0, 3.4), Exit("left 3", 1, 3.8, 5.8),
        Exit("right", -1, 0.6, 5.5), STRAIGHT,
    )
)  # fmt: skip
APART = Exits((Exit("left", 1, 1.5, 3.5), Exit("right", -1, 2.5, 5.0), STRAIGHT))
LATE = 0.5 * math.pi / 0.1  # [rad/s]
LAB: dict[str, Any] = {
    "sensors": Camera(),
    "randomisation": Randomisation(friction=0.2, com_offset=0.2),
    "actuators": Actuators(axis_speed=LATE, stuck_share=0.02),
}


def sorting_benchmark(task: Any) -> StreamBenchmark:
    """Return streams of two mixes of boxes at three speeds, with two layouts of exits.

    The result of a stream is the highest rate that a controller sustains.
    """
    brief = replace(task, duration=30.0)
    offers = tuple(
        Offer(
            f"{mix}, {speed:g} m/s",
            replace(brief, stream=Stream(Steady(1.0), parcels, speeds=speed), exits=exits),
            rates=(), group=exits, kinds=("rule", "agent"),
        )
        for exits in GROUPS
        for mix, parcels in MIXES.items()
        for speed in SPEEDS
    )  # fmt: skip
    return StreamBenchmark(
        task, offers, (TOUCHES, STAY), "boxes at a steady rate, each to an exit by chance",
        replications=30, warm_up=8.0, filmed="S and B, 1.5 m/s", held_out=_unseen(brief),
    )  # fmt: skip


def _unseen(task: Any) -> tuple[Offer, ...]:
    """Return streams, exits and hardware on which no agent was trained."""
    late, stuck = Actuators(axis_speed=LATE), Actuators(stuck_share=0.02)
    camera = {"sensors": Camera(), "randomisation": Randomisation(friction=0.2)}
    some: tuple[tuple[str, Any, dict[str, Any], dict[str, Any], float], ...] = (
        ("exits “chutes”", BOXES, {"exits": "chutes"}, {}, 0.0),
        ("exits staggered", ("S",), {"exits": STAGGERED}, {}, 0.0),
        ("three exits left", BOXES, {"exits": THREE_LEFT}, {}, 0.0),
        ("exits apart", BOXES, {"exits": APART}, {}, 0.0),
        ("axes turn in 100 ms", ("S",), {}, {"actuators": late}, 0.0),
        ("axes turn in 100 ms", BOXES, {}, {"actuators": late}, 0.0),
        ("2 % of modules stuck", BOXES, {}, {"actuators": stuck}, FEW),
        ("camera, friction ±20 %", BOXES, {}, camera, 0.0),
        ("lab", SIZES, {}, LAB, SEVERAL),
        ("lab, six angles", SIZES, {}, {"orientations": SIX, **LAB}, SEVERAL),
        ("lab, exits “chutes”", SIZES, {"exits": "chutes"}, LAB, SEVERAL),
    )
    found = [
        _offer(task, name, Stream(Steady(1.0), parcels, speeds=1.5), own, given, touches)
        for name, parcels, own, given, touches in some
    ]
    for boxes in (("S",), BOXES):
        for speeds in ((1.0, 1.25), (1.0, 1.5), (1.0, 2.0)):
            name = f"Poisson, {speeds[0]:g} to {speeds[1]:g} m/s"
            stream = Stream(Poisson(1.0), boxes, speeds=speeds)
            found.append(_offer(task, name, stream, {}, {}, FEW))
    return tuple(found)


def _offer(
    task: Any, name: str, stream: Stream, own: dict[str, Any], given: dict[str, Any],
    most_touches: float,
) -> Offer:  # fmt: skip
    kinds = stream.kinds
    parcels = f"{len(kinds)} sizes" if len(kinds) > 2 else " and ".join(BOXES[: len(kinds)])
    made = replace(task, stream=stream, **{"exits": "sides", **own})
    return Offer(
        f"{name}, {parcels}", made, (ENTRANCE,), arguments=given, most_touches=most_touches
    )


SECONDS = 200.0  # [s] duration of a stream on a slope
BULK, ROWS = 14_000.0, 10_000.0  # [parcels/h] above every method's capacity
# [parcels/h] tried rates of ordered streams
RATES = tuple(np.arange(600.0, 3400.0, 200.0).tolist())
ORDERED = {4: 3000.0, 8: 2000.0}  # [parcels/h] rate of the comparison by window
ALIGNMENT = math.radians(10.0)
PLANNED = (*KINDS, "planner")
TAKE_AWAY_PRESETS = ("exact", "camera", "lab")
TAKE_AWAY_COLUMNS: tuple[ResultColumn, ...] = (
    share_column("correct_gaps", "gaps", "of at least the asked gap on the take-away"),
    share_column("aligned", "aligned", "of the parcels that left by a mouth"),
    share_column("beside", "beside", "that left beside the mouths or over the sides"),
    TOUCHES,
    ResultColumn(
        "squeeze_most", "squeeze [N]", "largest force between two",
        lambda runs, _: runs.most("squeeze_most"), ".0f",
    ),
    STAY,
)  # fmt: skip
OFFERED = "more is offered than the surface takes"


def _on_slope(
    task: Any, offers: tuple[Offer, ...], description: str, filmed: str
) -> StreamBenchmark:
    return StreamBenchmark(
        task, offers, TAKE_AWAY_COLUMNS, description, TAKE_AWAY_PRESETS, filmed=filmed
    )


def singulation_benchmark(task: Any, stops: Any) -> StreamBenchmark:
    """Return four streams of a bulk of parcels. The first three streams differ in their exits.

    In the last stream, the take-away (the conveyor after the slope) stops at times. The argument
    `stops` describes these stops.
    """
    whole = replace(task, duration=SECONDS)
    mouth = replace(whole, exits="mouth", alignment=ALIGNMENT)
    offers = (
        Offer("anywhere across", whole, (BULK,)),
        Offer("mouth of 0.6 m, 10 deg", mouth, (BULK,), kinds=PLANNED),
        Offer("two mouths, 10 deg", replace(mouth, exits="mouths"), (BULK,)),
        Offer(
            "mouth, take-away stops", replace(mouth, demand=stops), (BULK,), kinds=("rule", "agent")
        ),
    )
    return _on_slope(task, offers, OFFERED, "mouth of 0.6 m, 10 deg")


def merging_benchmark(task: Any, two: Any) -> StreamBenchmark:
    """Return streams on three lines, and on two lines whose inlets are `two`."""
    whole = replace(task, duration=SECONDS)
    offers = (
        Offer("three lines", whole, (ROWS,), kinds=PLANNED),
        Offer("two lines", replace(whole, inlets=two), (ROWS,)),
    )
    return _on_slope(task, offers, OFFERED, "three lines")


def sequencing_benchmark(task: Any) -> StreamBenchmark:
    """Return streams whose order is shuffled within windows of 2, 4 and 8 successive parcels.

    For each window, the test finds the highest rate that a controller sustains. The windows of 4
    and 8 are also tested at a fixed rate.
    """
    by_window = {
        k: replace(task, duration=SECONDS, stream=replace(task.stream, window=k)) for k in (2, 4, 8)
    }
    offers = (
        *(
            Offer(f"window of {k}", each, RATES[::-1], kinds=("rule",))
            for k, each in by_window.items()
        ),
        *(
            Offer(f"window of {k}, {rate:g} an hour", by_window[k], (rate,))
            for k, rate in ORDERED.items()
        ),
    )
    description = (
        f"at the rate that is named, or the highest, in steps of {RATES[1] - RATES[0]:g} an hour, "
        "at which 99.9 % of all depart correctly and none of the streams jams"
    )
    return _on_slope(task, offers, description, "window of 4, 3000 an hour")
