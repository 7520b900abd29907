"""The comparison of kinds of modules: idle rotors beside driven modules, each with its best method.

With one parcel, idle rotors run the task's rules and shipped agents, and the best of these methods
is shown; driven modules run `AimRule`. The scheduler sorts streams with both kinds of modules. If a
stream ends at a take-away conveyor, idle rotors run `Patterns` on a slope, and driven modules run
`VelocityRule` on a level surface.
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
from surface_gym.flow.benchmarks import GROUPS, SIX
from surface_gym.modules import ModuleKind, find_module
from surface_gym.randomisation import Actuators
from surface_gym.tasks.benchmark import Offer

from ..base import Controller
from ..library import QUEUE, task_label
from ..rollout import Episodes
from ..rules.patterns import Patterns
from ..rules.steering import AIMS, AimRule
from ..rules.velocities import COLUMNS, MODULES, VelocityRule
from ..scheduling.driven import AHEAD_ONLY, COLUMN_BELTS, STREAM_KINDS, TAKE_AWAY_KINDS
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
from .results import Results, Sample
from .scenario import STARTS, WHOLE, Extent, Row, Scenario, ScenarioJob, StartScenario, make_jobs
from .streams import (
    LEAST_CORRECT,
    STREAM_PRESETS,
    UNSEEN,
    StreamScenario,
    measure_stream,
    play_stream,
)
from .tables import Table, number, show_tables, tabulate, write_markdown
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
LAB = STREAM_PRESETS["lab"]
# [m/s^2] of driven surfaces
ACCELERATION = {"exact": math.inf, DELAYED.name: 10.0, LAB.name: 10.0}
REPLICATIONS = 12  # streams at each rate
# Names of the compared streams with a take-away; number of replications, duration [s], warm-up [s]
# that is not counted, and offered rate [parcels/h].
BEFORE_TAKE_AWAY = ("anywhere across", "mouth of 0.6 m, 10 deg", "three lines")
STREAMS, SECONDS, WARM_UP, OFFERED = 6, 60.0, 10.0, 14_000.0


def kind_methods(task: str) -> list[Method]:
    """List a task's methods: methods of idle rotors, then a method for each kind of driven modules.

    In a method of driven modules, the argument `modules` is a function that makes the modules.
    `_suited` calls this function with an acceleration [m/s^2] and, on streams, a speed [m/s].
    """
    given: dict[str, Any] = {"info": ("energy", "turns")}
    make: Callable[..., Any]
    kinds: Mapping[str, Callable[..., ModuleKind]]
    if _is_before_take_away(task):
        given |= {"actions": "modules"}
        rest: list[Method] = []
        for kind, each in TAKE_AWAY_KINDS.items():
            rule = partial(VelocityRule, drives=COLUMNS if kind == COLUMN_BELTS else MODULES)
            own = given | {"modules": each, "tilt": 0.0}
            rest.append(Method(kind, task, partial(seedless, rule), own))
        return [Method(IDLE, task, partial(seedless, Patterns), given), *rest]
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


def _is_before_take_away(task: str) -> bool:
    """Return whether a task is on streams that end at a take-away conveyor."""
    return is_on_streams(task) and bool(stream_benchmark(task).task.takes_away)


def _suited(method: Method, **given: Any) -> Method:
    """Return a method whose driven modules have the values `given`.

    A method with idle rotors is returned unchanged. `given` is an acceleration [m/s^2] and, on
    streams, also a speed [m/s].
    """
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
    """A stream at the highest rate that a method sustains, or at a fixed rate before a take-away.

    If the stream ends at a take-away conveyor, more parcels arrive than the conveyor can take away,
    and driven modules have speeds that suit the conveyor. In all other streams, driven modules have
    speeds that suit the stream's parcels.
    """

    @property
    def offer(self) -> Offer:
        found = super().offer
        return replace(found, rates=(OFFERED,)) if found.task.takes_away else found

    @property
    def least_correct(self) -> float:
        return LEAST_CORRECT["exact"]

    def accepts(self, method: Method) -> bool:
        narrow = self.offer.task.takes_away and self.offer.task.exits != "end"
        return not (narrow and method.name in AHEAD_ONLY)

    def play(self, method: Method, seed: int) -> list[Row]:
        config = self.config(method)
        count = config.site.rotor.any(axis=0) if method.name == COLUMN_BELTS else config.site.rotor
        motors = int(count.sum()) * sum(config.module_kind.motors)
        return [{**row, "motors": motors} for row in super().play(method, seed)]

    def config(self, method: Method, rate: float | None = None) -> EnvConfig:
        task, acceleration = self.offer.task, ACCELERATION[self.preset]
        speed = task.take_away if task.takes_away else task.stream.speeds
        method = _suited(method, acceleration=acceleration, speed=speed)
        if self.preset == LAB.name:
            return StreamScenario.config(self, method, rate)
        given = method.arguments | {"actuators": DRIVE_PRESETS[self.preset].actuators}
        alone = replace(self, preset=UNSEEN)  # without a preset of its own
        return StreamScenario.config(alone, replace(method, arguments=given), rate)

    def _measure(
        self, method: Method, config: EnvConfig, controller: Controller, least_correct: float = 0.0
    ) -> list[Row]:
        if not self.offer.task.takes_away:
            return super()._measure(method, config, controller, least_correct)
        batch = play_stream(config, controller, self.episodes(method))
        assert batch is not None  # no share of correct deliveries is required
        streams, counted = batch.streams, config.stream_task.duration - WARM_UP
        late = streams.departed > WARM_UP
        correct, delivered = (late & streams.correct).sum(axis=1), late.sum(axis=1)
        return [
            {**row, "counted": counted, "correct": int(correct[k]), "delivered": int(delivered[k])}
            for k, row in enumerate(measure_stream(batch))
        ]

    def episodes(self, method: Method) -> int:
        count = STREAMS if self.offer.task.takes_away else REPLICATIONS
        return min(count, super().episodes(method))


def drive_jobs(tasks: Sequence[str], extent: Extent = WHOLE) -> list[ScenarioJob]:
    """List the jobs that compare kinds of modules. `extent` limits the size of the comparison."""
    jobs: list[ScenarioJob] = []
    for task in tasks:
        scenarios: list[Scenario] = []
        if is_on_streams(task):
            offers = [each for each in stream_benchmark(task).offers if _is_compared(each)]
            presets: Sequence[str] = tuple(DRIVE_PRESETS)
            own = extent
            if _is_before_take_away(task):
                presets = ("exact", LAB.name)
                own = replace(extent, duration=min(SECONDS, extent.duration))
            scenarios = [
                DriveScenario(task, preset, own, each.scenario)
                for each in offers[: extent.offers]
                for preset in presets
            ]
        elif task in AIMS:
            scenarios = [DriveStarts(task, preset, extent) for preset in DRIVE_PRESETS]
        if scenarios:
            jobs += make_jobs(scenarios, kind_methods(task))
    return jobs


def _is_compared(offer: Offer) -> bool:
    """Return whether kinds of modules are compared on a stream of a benchmark.

    If a task has a take-away conveyor, `BEFORE_TAKE_AWAY` names the compared streams. In other
    tasks, a stream is compared if the stream has the exits `GROUPS[0]`, several kinds of parcels,
    and no given rates.
    """
    task = offer.task
    if task.takes_away:
        return offer.name in BEFORE_TAKE_AWAY
    return not offer.rates and offer.group == GROUPS[0] and len(task.stream.kinds) > 1


def drive_tables(task: str, results: Results, turn_energy: float = 0.0) -> list[Table]:
    """Return a task's table of kinds of modules in a list; the list is empty without results.

    Args:
        turn_energy: [J] energy of a turn of an axis.
    """
    make_rows = _stream_rows if is_on_streams(task) else _start_rows
    rows = make_rows(task, results, turn_energy)
    caption = (
        "Each kind with its best method here. With delays, " + DELAYED.meaning[0].lower()
        + DELAYED.meaning[1:] + " Energy is what drives draw; a braking "
        f"drive gives nothing back. A turn of an axis takes {turn_energy:g} J. Acceleration: "
        "the largest of a parcel, mean."
    )  # fmt: skip
    if _is_before_take_away(task):
        caption += " Idle rotors are on the slope, driven modules are level. Lab: " + LAB.meaning
    elif is_on_streams(task):
        caption += " Rates are the highest sustained ones with 99.9 % correct deliveries."
    return tabulate(f"{task_label(task)}, kinds of modules", caption, rows, keys=2)


def _start_rows(task: str, results: Results, turn_energy: float) -> list[dict[str, str]]:
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
            rows.append(row | _energies(sample, turn_energy, sample.success.size))
    return rows


def _delays(preset: str) -> str:
    return "yes" if preset == DELAYED.name else "no"


def _hardware(method: Method) -> dict[str, str]:
    """Return a table's cell with the numbers of drives and axes in the method's type of module."""
    module = _suited(method, acceleration=math.inf).arguments.get("modules", "idle")
    drives, axes = find_module(module).motors
    return {"drives and axes": f"{drives} + {axes}"}


def _per_parcel(sample: Sample, name: str = "drawn_energy", parcels: float | None = None) -> float:
    """Return the sum of a column divided by the number of parcels, or NaN without parcels.

    Args:
        name: column of the sample; the default is the drives' energy [J].
        parcels: number of parcels; the default is the number of sorted parcels.
    """
    count = float(sample.values("sorted").sum()) if parcels is None else parcels
    return float(sample.values(name).sum()) / count if count else math.nan


def _energies(sample: Sample, turn_energy: float, parcels: float | None = None) -> dict[str, str]:
    peak = float(sample.values("peak_acceleration").mean())
    turns = _per_parcel(sample, "axis_turns", parcels)
    return {
        "turns of axes": number(turns, ".1f"),
        "energy [J]": number(_per_parcel(sample, parcels=parcels) + turn_energy * turns, ".1f"),
        "acceleration [m/s^2]": number(peak, ".1f"),
    }


def _worth(sample: Sample, metric: str) -> tuple[float, float]:
    """Return a sort key of a method: its success rate, and a metric's median with minus sign."""
    values = sample.metric(metric)[sample.success]
    return round(sample.rate, 2), -float(np.median(values)) if values.size else -math.inf


def _stream_rows(task: str, results: Results, turn_energy: float) -> list[dict[str, str]]:
    rows = []
    takes_away = _is_before_take_away(task)
    for (_, scenario, preset, name), sample in results.among(task):
        rate = float(sample.rates.mean())
        row = {"stream": scenario, "modules": name}
        row |= {"sensors": preset} if takes_away else {"delays": _delays(preset)}
        row["right [1/h]"] = number(rate, ".0f")
        if takes_away:
            row["right [1/h]"] += f" ±{sample.margin:.0f}"
            row |= {"correct": number(sample.share_correct, ".1%"), "jams": f"{sample.jams:.0f}"}
            row["touches/1000"] = number(sample.mean("touches_per_1000"), ".0f")
            row["motors"] = number(sample.constant("motors"), ".0f")
        else:
            row["of the entry's limit"] = number(rate / sample.constant("bound"), ".0%")
        rows.append(row | _energies(sample, turn_energy))
    return sorted(rows, key=lambda row: (row["stream"], row["sensors" if takes_away else "delays"]))


def write_tables(
    tasks: Sequence[str], table: pd.DataFrame, folder: Path, console: Console, note: str = "",
    turn_energy: float = 0.0,
) -> None:  # fmt: skip
    """Write the tables of kinds of modules to a folder, and print them.

    `table` has the results of all `drive_jobs`. `note` is a remark above the tables.
    `turn_energy` [J] is the energy of a turn of an axis.
    """
    results = Results(table)
    tables = [each for task in tasks for each in drive_tables(task, results, turn_energy)]
    if any(_is_sorter(key) for key in results.samples):
        _draw_streams(results, folder / "modules.png")
    write_markdown(tables, folder / "modules.md", TITLE + (f"{note}\n\n" if note else ""))
    show_tables(tables, console, note)


def _is_sorter(key: tuple[str, ...]) -> bool:
    """Return whether the results with this key come from a stream to be sorted."""
    return is_on_streams(key[0]) and not _is_before_take_away(key[0])


def _draw_streams(results: Results, file: Path) -> None:
    """Draw throughput and energy of each kind of modules, on streams without a take-away."""
    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    found = {key: sample for key, sample in results.samples.items() if _is_sorter(key)}
    presets = [preset for preset in DRIVE_PRESETS if any(key[2] == preset for key in found)]
    panels = figure.subplots(2, len(presets), sharex=True, sharey="row", squeeze=False)
    for column, preset in zip(panels.T, presets, strict=True):
        samples = {(key[1], key[3]): sample for key, sample in found.items() if key[2] == preset}
        offers, names = (list(dict.fromkeys(each)) for each in zip(*samples, strict=True))
        shown = (lambda sample: float(sample.rates.mean()), _per_parcel)
        for panel, value in zip(column, shown, strict=True):
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
