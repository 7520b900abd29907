"""The comparison of kinds of modules: idle rotors beside driven modules, each with its best method.

Idle rotors act with the shipped agents and rules of a task, and the best of them is shown. Driven
modules act with `AimRule` for one parcel, and with the scheduler for streams.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from rich.console import Console

from surface_gym.config import PRESETS, QUARTER_TURN, EnvConfig, Preset
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.benchmarks import GROUPS, SIX
from surface_gym.modules import ModuleKind, OmniModule, PopUp, SteeredRoller, find_module
from surface_gym.randomisation import Actuators
from surface_gym.tasks.benchmark import Offer

from ..library import QUEUE, task_label
from ..rollout import Episodes
from ..rules.steering import AIMS, AimRule, Make
from ..scheduling.scheduler import make_scheduler
from .method import (
    Method,
    is_on_streams,
    rules,
    seedless,
    shipped,
    start_benchmark,
    stream_benchmark,
)
from .pictures import Bar, draw_bars, save_figure
from .report import show_tables
from .results import Results, Sample
from .scenario import STARTS, WHOLE, Extent, Scenario, ScenarioJob, StartScenario, make_jobs
from .streams import LEAST_CORRECT, UNSEEN, StreamScenario
from .tables import Table, number, tabulate, write_markdown
from .views import column_value, format_value

TITLE = "# Kinds of modules\n\nIdle rotors beside driven modules.\n\n"
IDLE = "idle rotors"
# Modules obey at once, or with delays.
DELAYED = Preset(
    "delayed",
    "delayed",
    "Axes turn by 90 deg in 50 ms, and driven surfaces change their speed by 10 m/s^2.",
    actuators=Actuators(axis_speed=0.5 * math.pi / QUARTER_TURN),
)
DRIVE_PRESETS = {"exact": PRESETS["exact"], DELAYED.name: DELAYED}
ACCELERATION = {"exact": math.inf, DELAYED.name: 10.0}  # [m/s^2] of driven surfaces
REPLICATIONS = 12  # streams at each rate
DIAGONAL = math.sqrt(2.0)  # speed aside of a pop-up, over the stream's
GENTLE, STEEP = math.radians(10.0), math.radians(30.0)  # [rad] headings aside
RISE = QUARTER_TURN  # [s] until the belts of a pop-up have risen


def _for_stream(kind: Make, heading: float, speed: float, acceleration: float) -> ModuleKind:
    """Return driven modules that keep a stream's speed [m/s] along the line, also aside."""
    speeds, headings = (speed, speed / math.cos(heading)), (0.0, heading, -heading)
    return kind(acceleration, speeds, headings, conveyor=speed)


def _pop_up(speed: float, acceleration: float) -> ModuleKind:
    """Return pop-ups for a stream; their belts run already as they rise."""
    fast = DIAGONAL * speed
    if acceleration != math.inf:
        acceleration = math.hypot(speed, fast) / RISE
    return PopUp(acceleration, (speed, fast), conveyor=speed)


STREAM_KINDS: dict[str, Callable[..., ModuleKind]] = {
    "pop-up": _pop_up,
    "steered rollers, 10 deg": partial(_for_stream, SteeredRoller, GENTLE),
    "steered rollers, 30 deg": partial(_for_stream, SteeredRoller, STEEP),
    "omni-wheels, 10 deg": partial(_for_stream, OmniModule, GENTLE),
}


def kind_methods(task: str) -> list[Method]:
    """List the methods of a task: of idle rotors first, then one for each kind of driven modules.

    An argument `modules` is a function that makes the modules; see `_suited`.
    """
    given: dict[str, Any] = {"info": ("energy",)}
    make: Callable[..., Any]
    kinds: Mapping[str, Callable[..., ModuleKind]]
    if is_on_streams(task):
        given |= {"actions": "parcels", "gate": True, "queue": QUEUE}
        make, kinds = make_scheduler, STREAM_KINDS
        idle = [Method(IDLE, task, partial(seedless, make), given | {"orientations": SIX})]
    else:
        known = [each for each in (*rules(task), *shipped(task)) if each.most is None]
        idle = [
            replace(each, name=f"{IDLE}, {each.name}", arguments=each.arguments | given,
                    presets=None)
            for each in known
        ]  # fmt: skip
        given |= {"actions": "halves"}
        make, kinds = AimRule, AIMS[task].kinds
    return [
        *idle,
        *(
            Method(kind, task, partial(seedless, make), given | {"modules": each})
            for kind, each in kinds.items()
        ),
    ]


def _suited(method: Method, **given: Any) -> Method:
    """Return a method with modules of an acceleration, and for a stream of a speed."""
    make = method.arguments.get("modules")
    if make is None:
        return method
    return replace(method, arguments=method.arguments | {"modules": make(**given)})


@dataclass(frozen=True)
class DriveStarts(StartScenario):
    """The starts of a task, with modules that obey at once or with delays."""

    presets = DRIVE_PRESETS

    def run(
        self, method: Method, seed: int
    ) -> tuple[Episodes, EnvConfig, tuple[dict[str, Any], ...]]:
        return super().run(_suited(method, acceleration=ACCELERATION[self.preset]), seed)


@dataclass(frozen=True)
class DriveScenario(StreamScenario):
    """A stream at its highest sustained rate, whose driven modules suit its speed."""

    @property
    def least_correct(self) -> float:
        return LEAST_CORRECT["exact"]

    def config(self, method: Method, rate: float | None = None) -> EnvConfig:
        acceleration, speed = ACCELERATION[self.preset], self.offer.task.stream.speeds
        method = _suited(method, acceleration=acceleration, speed=speed)
        given = method.arguments | {"actuators": DRIVE_PRESETS[self.preset].actuators}
        alone = replace(self, preset=UNSEEN)  # without a preset of its own
        return StreamScenario.config(alone, replace(method, arguments=given), rate)

    def episodes(self, method: Method) -> int:
        return min(REPLICATIONS, super().episodes(method))


def drive_jobs(tasks: Sequence[str], extent: Extent = WHOLE) -> list[ScenarioJob]:
    """List the jobs of the comparison of kinds of modules, for the tasks that take part."""
    jobs: list[ScenarioJob] = []
    for task in tasks:
        scenarios: list[Scenario] = []
        if is_on_streams(task):
            offers = [each for each in stream_benchmark(task).offers if _is_compared(each)]
            scenarios = [
                DriveScenario(task, preset, extent, each.scenario)
                for each in offers[: extent.offers]
                for preset in DRIVE_PRESETS
            ]
        elif task in AIMS:
            scenarios = [DriveStarts(task, preset, extent) for preset in DRIVE_PRESETS]
        if scenarios:
            jobs += make_jobs(scenarios, kind_methods(task))
    return jobs


def _is_compared(offer: Offer) -> bool:
    """Return whether an offer is a search for the capacity with a mix of parcels."""
    task = offer.task
    return not offer.rates and offer.group == GROUPS[0] and len(task.stream.kinds) > 1


def drive_tables(task: str, results: Results) -> list[Table]:
    """Make the table of kinds of modules for a task; none without results."""
    rows = _stream_rows(task, results) if is_on_streams(task) else _start_rows(task, results)
    caption = (
        "Each kind with its best method here. With delays, " + DELAYED.meaning[0].lower()
        + DELAYED.meaning[1:] + " Energy is what drives draw; a braking "
        "drive gives nothing back. Acceleration: the largest of a parcel, mean."
    )  # fmt: skip
    if is_on_streams(task):
        caption += " Rates are the highest sustained ones with 99.9 % right deliveries."
    return tabulate(f"{task_label(task)}, kinds of modules", caption, rows, keys=2)


def _start_rows(task: str, results: Results) -> list[dict[str, str]]:
    methods = {each.name: each for each in kind_methods(task)}
    rows = []
    for preset in DRIVE_PRESETS:
        ran = results.at(task, STARTS, preset)
        idle = [name for name in ran if name.startswith(IDLE)]
        if not idle:
            continue
        metric = start_benchmark(task).error or "time"
        best = max(idle, key=lambda name: _worth(ran[name], metric))
        for name in (best, *(each for each in ran if each not in idle)):
            sample = ran[name]
            row = {"modules": name, "delays": _delays(preset), **_hardware(methods[name])}
            row["success"] = number(sample.rate, ".3f")
            row["time [s]"] = number(float(sample.time[sample.success].mean()), ".2f")
            for column in start_benchmark(task).columns:
                if not column.every_start:
                    value = column_value(column, sample, ran[idle[0]])
                    row[column.label] = format_value(column, value)
            rows.append(row | _energies(sample, sample.success.size))
    return rows


def _delays(preset: str) -> str:
    return "yes" if preset == DELAYED.name else "no"


def _hardware(method: Method) -> dict[str, str]:
    """Return the motors of a module of a method's kind."""
    module = _suited(method, acceleration=math.inf).arguments.get("modules", "idle")
    drives, axes = find_module(module).motors
    return {"drives and axes": f"{drives} + {axes}"}


def _rate(sample: Sample) -> float:
    """Return the right deliveries per hour, mean over streams."""
    return float((HOUR * sample.values("correct") / sample.values("counted")).mean())


def _energy_per_parcel(sample: Sample, parcels: float | None = None) -> float:
    """Return the energy [J] that drives draw per parcel; None: per sorted one. NaN: none."""
    count = float(sample.values("sorted").sum()) if parcels is None else parcels
    return float(sample.values("drawn_energy").sum()) / count if count else math.nan


def _energies(sample: Sample, parcels: float | None = None) -> dict[str, str]:
    peak = float(sample.values("peak_acceleration").mean())
    return {
        "energy [J]": number(_energy_per_parcel(sample, parcels), ".1f"),
        "acceleration [m/s^2]": number(peak, ".1f"),
    }


def _worth(sample: Sample, metric: str) -> tuple[float, float]:
    """Return how good a method is: by its successes, then by a metric of them."""
    values = sample.metric(metric)[sample.success]
    return round(sample.rate, 2), -float(np.median(values)) if values.size else -math.inf


def _stream_rows(task: str, results: Results) -> list[dict[str, str]]:
    rows = []
    for (_, scenario, preset, name), sample in results.among(task):
        rate = _rate(sample)
        rows.append(
            {
                "stream": scenario, "modules": name, "delays": _delays(preset),
                "right [1/h]": number(rate, ".0f"),
                "of the entry's limit": number(rate / sample.constant("bound"), ".0%"),
                **_energies(sample),
            }
        )  # fmt: skip
    return sorted(rows, key=lambda row: (row["stream"], row["delays"]))


def write_tables(
    tasks: Sequence[str], table: pd.DataFrame, folder: Path, console: Console, note: str = ""
) -> None:
    """Write the tables of kinds of modules to a folder, and print them."""
    results = Results(table)
    tables = [each for task in tasks for each in drive_tables(task, results)]
    if any(is_on_streams(key[0]) for key in results.samples):
        _draw_streams(results, folder / "modules.png")
    write_markdown(tables, folder / "modules.md", TITLE + (f"{note}\n\n" if note else ""))
    show_tables(tables, console, note)


def _draw_streams(results: Results, file: Path) -> None:
    """Draw throughput and energy of each kind on the streams, at once and with delays."""
    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    panels = figure.subplots(2, len(DRIVE_PRESETS), sharex=True, sharey="row")
    for column, preset in zip(panels.T, DRIVE_PRESETS, strict=True):
        samples = {
            (key[1], key[3]): sample
            for key, sample in results.samples.items()
            if key[2] == preset and is_on_streams(key[0])
        }
        offers, names = (list(dict.fromkeys(each)) for each in zip(*samples, strict=True))
        for panel, value in zip(column, (_rate, _energy_per_parcel), strict=True):
            draw_bars(
                panel, offers, names,
                lambda *key, value=value, samples=samples: (
                    Bar(value(samples[key])) if key in samples else None
                ),
            )  # fmt: skip
        column[0].set_title("without delays" if preset != DELAYED.name else "with delays")
        column[1].set_xticks(range(len(offers)), [each.split(", ")[1] for each in offers])
        column[1].set_xlabel("speed of the stream")
    panels[0, 0].set_ylabel("right deliveries per hour")
    panels[1, 0].set_ylabel("energy of the drives [J a parcel]")
    save_figure(figure, file, *panels.ravel(), legend=panels[0, 0])
