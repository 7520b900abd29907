"""The agent of streams beside the scheduler, on lines that it never trained on: other exits, late
axes, stuck modules, cameras, the lab, and parcels that come by chance, of mixed sizes and speeds.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Poisson, Steady
from surface_gym.flow.exits import Exit, Exits
from surface_gym.flow.stream import Stream
from surface_gym.parallel import Workers

from .. import library
from ..base import Controller, Numbers
from ..scheduling.bounds import entrance_bound
from ..scheduling.decisions import make_model_library
from ..scheduling.scheduler import Scheduler, find_plain
from .benchmark import Advance, compute_kept, half_interval
from .capacity import SECONDS, STREAM_PRESETS, Measurement, measure_stream
from .streams import LEARNED, SIX
from .tables import Table, bold, write_markdown, write_numbers

NAME = "flow-generalisation"
FILE = f"{NAME}.jsonl"
SCHEDULER = "scheduler"
FEW = 0.05  # [-] touches per delivery that are allowed where models err
SEVERAL = 0.1  # [-] in the lab
BOXES = ("S", "B")
SIZES = tuple(
    sg.Parcel(sg.Rectangle(*each))
    for each in ((0.2, 0.2), (0.25, 0.3), (0.3, 0.2), (0.35, 0.35), (0.4, 0.3), (0.45, 0.45))
)
STAGGERED = Exits(
    (
        Exit("left 1", 1, 0.6, 2.0), Exit("right 1", -1, 1.0, 2.6), Exit("left 2", 1, 3.0, 4.0),
        Exit("right 2", -1, 4.0, 5.5), Exit("straight", 0),
    )
)  # fmt: skip
THREE_LEFT = Exits(
    (
        Exit("left 1", 1, 0.5, 1.8), Exit("left 2", 1, 2.0, 3.4), Exit("left 3", 1, 3.8, 5.8),
        Exit("right", -1, 0.6, 5.5), Exit("straight", 0),
    )
)  # fmt: skip
APART = Exits((Exit("left", 1, 1.5, 3.5), Exit("right", -1, 2.5, 5.0), Exit("straight", 0)))
LATE = 0.5 * math.pi / 0.1  # [rad/s]
LAB: dict[str, Any] = {
    "sensors": sg.sensors.Camera(),
    "randomisation": sg.Randomisation(friction=0.2, com_offset=0.2),
    "actuators": sg.Actuators(axis_speed=LATE, stuck_share=0.02),
}


@dataclass(frozen=True)
class Scenario:
    """A line and its stream, offered as much as the entrance takes, and what touches are allowed
    in the trials by which controllers choose how close parcels follow each other.
    """

    name: str
    config: EnvConfig
    most_touches: float = 0.0  # [-] per delivery


def scenarios() -> list[Scenario]:
    """List the scenarios of the comparison."""
    late = sg.Actuators(axis_speed=LATE)
    stuck = sg.Actuators(stuck_share=0.02)
    preset = STREAM_PRESETS["camera"]
    camera = {"sensors": preset.sensors, "randomisation": preset.randomisation}
    held_out = (
        ("exits “chutes”", BOXES, {"exits": "chutes"}, 0.0),
        ("exits staggered", ("S",), {"exits": STAGGERED}, 0.0),
        ("three exits left", BOXES, {"exits": THREE_LEFT}, 0.0),
        ("exits apart", BOXES, {"exits": APART}, 0.0),
        ("axes turn in 100 ms", ("S",), {"actuators": late}, 0.0),
        ("axes turn in 100 ms", BOXES, {"actuators": late}, 0.0),
        ("2 % of modules stuck", BOXES, {"actuators": stuck}, FEW),
        ("camera, friction ±20 %", BOXES, camera, 0.0),
        ("lab", SIZES, LAB, SEVERAL),
        ("lab, six angles", SIZES, {"orientations": SIX, **LAB}, SEVERAL),
        ("lab, exits “chutes”", SIZES, {"exits": "chutes", **LAB}, SEVERAL),
    )
    found = [
        Scenario(f"{name}, {_name(parcels)}", _config(parcels, 1.5, **given), touches)
        for name, parcels, given, touches in held_out
    ]
    for parcels in (("S",), BOXES):
        for low, high in ((1.0, 1.25), (1.0, 1.5), (1.0, 2.0)):
            name = f"Poisson, {low:g} to {high:g} m/s, {_name(parcels)}"
            found.append(Scenario(name, _config(parcels, (low, high), Poisson), FEW))
    return found


def _name(parcels: Sequence[Any]) -> str:
    if parcels[0] in BOXES:
        return " and ".join(parcels)
    return f"{len(parcels)} sizes"


def _config(
    parcels: Sequence[Any],
    speeds: float | tuple[float, float],
    law: Callable[[float], Any] = Steady,
    **given: Any,
) -> EnvConfig:
    """Configure an environment that is offered as much as its entrance takes."""
    stream = Stream(law(1.0), parcels=tuple(parcels), speeds=speeds)
    whole = {"exits": "sides", **given}
    config = EnvConfig(
        "flow",
        stream=stream,
        actions="parcels",
        duration=SECONDS,
        gate=True,
        queue=library.QUEUE,
        **whole,
    )
    return config.replace(stream=stream.with_rate(entrance_bound(config)))


@dataclass(frozen=True)
class GeneralisationResult:
    """A controller under one scenario."""

    scenario: str
    controller: str  # "scheduler", or the agent with its seed
    entrance: float  # [parcels/h] that no controller can exceed
    measured: Measurement

    @property
    def key(self) -> tuple[str, str, str]:
        return ("flow", self.scenario, self.controller)


def generalisation_result(**plain: Any) -> GeneralisationResult:
    """Make a result from its fields as JSON has them."""
    return GeneralisationResult(**{**plain, "measured": Measurement(**plain["measured"])})


def make_best_scheduler(scenario: Scenario) -> Scheduler:
    """Make the scheduler of a surface as it should be or of one whose axes turn at once, whichever
    delivers more.
    """
    config = scenario.config
    whole = [make_model_library(config)]
    if config.actuators.stuck_share and math.isfinite(config.actuators.axis_speed):
        whole.append(make_model_library(config.replace(actuators=sg.Actuators())))
    found = [find_plain(config, made, scenario.most_touches) for made in whole]
    return max(found, key=itemgetter(1))[0]


def _compute(scenario: Scenario, controller: str, seed: int | None) -> GeneralisationResult:
    config = scenario.config
    acting: Controller
    if seed is None:
        acting = make_best_scheduler(scenario)
    else:
        acting = library.load(LEARNED, seed, config, scenario.most_touches)
    entrance = entrance_bound(config)
    found = measure_stream(config, acting, entrance)
    assert found is not None  # it is only where a share of right deliveries is asked for
    return GeneralisationResult(scenario.name, controller, entrance, found)


def compute_generalisation(
    workers: Workers, folder: Path | None = None, advance: Advance = lambda *_: None
) -> list[GeneralisationResult]:
    """Compute all results."""
    controllers: dict[str, int | None] = {SCHEDULER: None}
    if LEARNED in library.names():
        controllers |= {f"{LEARNED}, seed {seed}": seed for seed in library.seeds(LEARNED)}
    jobs = {
        ("flow", each.name, name): partial(_compute, each, name, seed)
        for each in scenarios()
        for name, seed in controllers.items()
    }
    file = None if folder is None else folder / FILE
    return list(compute_kept(jobs, generalisation_result, workers, file, advance).values())


def generalisation_table(results: Sequence[GeneralisationResult]) -> Table:
    """Show the rates of scheduler and agent under each scenario, and their paired difference."""
    rows = []
    for scenario in dict.fromkeys(each.scenario for each in results):
        rule, *agents = [each for each in results if each.scenario == scenario]
        learned = [each.measured for each in agents]
        mean = np.mean([each.rates for each in learned], axis=0)
        rows.append(
            (
                scenario, f"{rule.measured.rate:.0f} ±{rule.measured.margin:.0f}",
                f"{rule.measured.touches_per_1000:.1f}",
                f"{mean.mean():.0f} ±{half_interval(mean):.0f}",
                f"{np.mean([each.touches_per_1000 for each in learned]):.1f}",
                *_compare(rule.measured.rates, [each.rates for each in learned]),
                f"{rule.entrance:.0f}",
            )
        )  # fmt: skip
    return Table(
        f"flow: {LEARNED} beside the scheduler where it never trained",
        "Right deliveries an hour, offered as much as the entrance takes, with Student's 95 % "
        "interval, the mean of the agent's seeds; touches per 1000 deliveries; the agent's rate "
        "over the scheduler's, in pairs of the same parcels, in bold where the interval does not "
        "hold 1; and of how many seeds the interval alone is above 1. Both choose in a trial how "
        "close parcels follow each other: without a touch, or with at most "
        f"{1000.0 * FEW:g} per 1000 deliveries where modules are stuck and where speeds differ, "
        f"and {1000.0 * SEVERAL:g} in the lab.",
        (
            "scenario", "scheduler", "touches", LEARNED, "touches", "agent / scheduler",
            "seeds ahead", "entrance",
        ),
        tuple(rows),
    )  # fmt: skip


def _compare(rule: Numbers, agents: Sequence[Numbers]) -> tuple[str, str]:
    """Write the ratio of the agents' mean, and count the agents that are ahead by themselves."""
    apart = np.mean(agents, axis=0) - rule
    ratio, margin = 1.0 + apart.mean() / rule.mean(), half_interval(apart) / rule.mean()
    text = f"{ratio:.3f} ±{margin:.3f}"
    ahead = sum((each - rule).mean() > half_interval(each - rule) for each in agents)
    return bold(text) if abs(ratio - 1.0) > margin else text, f"{ahead} of {len(agents)}"


def generalisation_numbers(results: Sequence[GeneralisationResult]) -> list[dict[str, Any]]:
    """List every number, a row for each."""
    rows = []
    for row in results:
        values = {
            "entrance": row.entrance,
            "rate": row.measured.rate,
            "margin": row.measured.margin,
            "share right": row.measured.share_right,
            "touches per 1000": row.measured.touches_per_1000,
            "jams": row.measured.jams,
            "waiting": row.measured.waited,
        }
        rows += [
            {"scenario": row.scenario, "controller": row.controller, "metric": k, "value": v}
            for k, v in values.items()
        ]
    return rows


def write_generalisation(
    results: Sequence[GeneralisationResult], folder: Path, console: Console
) -> None:
    """Write flow-generalisation.md, .csv and .json into a folder, and show the table."""
    table = generalisation_table(results)
    write_markdown([table], folder / f"{NAME}.md")
    numbers = generalisation_numbers(results)
    write_numbers(numbers, folder / f"{NAME}.csv", folder / f"{NAME}.json")
    table.show(console)
