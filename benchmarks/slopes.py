"""`python -m benchmarks.slopes`: rules and agents on slopes with other tilts, mouths and lengths.

The methods were not trained or tuned on these slopes, except on the cases "as trained". Streams and
seeds are the same as in `python evaluate.py`. The tables show the correct departures per hour of
every method, and the number of streams that jammed. With `--seconds` and `--streams` the command
finds jams in long runs.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

from surface_gym import checks
from surface_gym.agents.evaluation.method import all_methods
from surface_gym.agents.evaluation.scenario import WHOLE
from surface_gym.agents.evaluation.streams import StreamScenario, measure_stream, play_stream
from surface_gym.config import EnvConfig
from surface_gym.flow.exits import Exit, Exits
from surface_gym.flow.take_away import slope_line
from surface_gym.parallel import map_jobs, usable_cores, without_report

METHODS = ("time slots", "patterns", "PPO per parcel", "PPO per module")
MOUTH, LINES = ("singulate", "mouth of 0.6 m, 10 deg"), ("merge", "three lines")
Change = Callable[[EnvConfig], EnvConfig]


def tilted(degrees: float, config: EnvConfig) -> EnvConfig:
    """Set the tilt [deg]."""
    return config.replace(tilt=math.radians(degrees))


def with_mouth(width: float, aside: float, config: EnvConfig) -> EnvConfig:
    """Set a single mouth at the end, with its width [m] and its distance from the middle [m]."""
    mouth = Exit("mouth", 0, aside - 0.5 * width, aside + 0.5 * width)
    return config.replace(exits=Exits((mouth,)))


def with_length(length: float, config: EnvConfig) -> EnvConfig:
    """Set the length [m] of the rotors."""
    return config.replace(line=slope_line(length))


def offering(rate: float, config: EnvConfig) -> EnvConfig:
    """Set the rate of arrivals [parcels/h]."""
    return config.replace(stream=config.stream_task.stream.with_rate(rate))


@dataclass(frozen=True)
class Case:
    """A scenario of `python evaluate.py` with one change."""

    name: str
    task: str
    scenario: str
    change: Change


CASES = (
    Case("mouth, as trained", *MOUTH, lambda config: config),
    Case("mouth, take-away stops", "singulate", "mouth, take-away stops", lambda config: config),
    Case("mouth, 6 deg", *MOUTH, partial(tilted, 6.0)),
    Case("mouth, 10 deg", *MOUTH, partial(tilted, 10.0)),
    Case("mouth of 0.5 m", *MOUTH, partial(with_mouth, 0.5, 0.0)),
    Case("mouth of 0.8 m", *MOUTH, partial(with_mouth, 0.8, 0.0)),
    Case("mouth 0.2 m aside", *MOUTH, partial(with_mouth, 0.6, 0.2)),
    Case("mouth 0.4 m aside", *MOUTH, partial(with_mouth, 0.6, 0.4)),
    Case("mouth, 3 m long", *MOUTH, partial(with_length, 3.0)),
    Case("mouth, 7 m long", *MOUTH, partial(with_length, 7.0)),
    Case("mouth, 4000 offered an hour", *MOUTH, partial(offering, 4000.0)),
    Case("three lines, as trained", *LINES, lambda config: config),
    Case("three lines, 6 deg", *LINES, partial(tilted, 6.0)),
    Case("three lines, 10 deg", *LINES, partial(tilted, 10.0)),
    Case("three lines, 3 m long", *LINES, partial(with_length, 3.0)),
    Case("three lines, 7 m long", *LINES, partial(with_length, 7.0)),
)


@dataclass(frozen=True)
class SlopeOptions:
    """Compare rules and agents on slopes with other tilts, mouths and lengths."""

    presets: tuple[str, ...] = ("exact", "lab")
    """Presets: exact, camera or lab."""
    cases: tuple[str, ...] = tuple(case.name for case in CASES)
    """Names of the cases."""
    methods: tuple[str, ...] = METHODS
    """Names of the rules and agents."""
    streams: int = 4
    """Streams of each case."""
    seconds: float = 200.0
    """[s] duration of a stream."""
    workers: int = usable_cores()
    """Number of processes; results do not depend on it."""


def run(name: str, preset: str, method: str, streams: int, seconds: float) -> str:
    """Return a table's cell: correct departures per hour, their share if below 99 %, and jams."""
    case = next(each for each in CASES if each.name == name)
    found = next(each for each in all_methods(case.task) if each.name == method)
    scenario = StreamScenario(case.task, preset, WHOLE, case.scenario)
    config = case.change(scenario.config(found, scenario.offer.rates[0]))
    config = config.replace(duration=seconds)
    batch = play_stream(config, found.controller(config, found.seeds[0]), streams)
    assert batch is not None
    rows = measure_stream(batch)
    rate = float(np.mean([row["parcels_per_hour"] for row in rows]))
    share = sum(row["correct"] for row in rows) / max(1, sum(row["delivered"] for row in rows))
    jams = sum(row["jam"] for row in rows)
    text = f"{rate:.0f}"
    text += f", {100.0 * share:.0f} % correct" if share < 0.99 else ""
    return text + (f", {jams:.0f} jams" if jams else "")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases, and print a table for each preset."""
    options = tyro.cli(SlopeOptions, prog="python -m benchmarks.slopes", args=arguments)
    names, methods = options.cases, options.methods
    for each in names:
        checks.one_of("cases", each, tuple(case.name for case in CASES))
    for preset in options.presets:
        jobs = [
            partial(run, case, preset, name, options.streams, options.seconds)
            for case in names
            for name in methods
        ]
        done = map_jobs([partial(without_report, each) for each in jobs], options.workers)
        found = dict(track(done, preset, total=len(jobs), console=Console(stderr=True)))
        table = Table(f"correct departures an hour, {preset}", *methods, box=SIMPLE_HEAD)
        for k, case in enumerate(names):
            table.add_row(case, *(found[len(methods) * k + j] for j in range(len(methods))))
        Console(width=140).print(table)


if __name__ == "__main__":
    main()
