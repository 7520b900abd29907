"""`python -m benchmarks.actuators`: success in the lab with axes that turn under load or that wait.

Agents, starts, seeds and intervals are the same as in `python evaluate.py --robustness`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import surface_gym as sg
from surface_gym import checks
from surface_gym.agents.base import Booleans
from surface_gym.agents.evaluation.method import Method, rules, shipped, start_benchmark
from surface_gym.agents.evaluation.results import interval
from surface_gym.agents.evaluation.scenario import SEED, Change, situation
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.scheduling.design import SIX, FlowCase
from surface_gym.agents.scheduling.scheduler import begin_streams, make_scheduler
from surface_gym.config import PRESETS, Preset
from surface_gym.flow.state import CORRECT, JAM, WRONG
from surface_gym.state import RUNNING

LAB = PRESETS["lab"]
UNLOADED = sg.Actuators(turns_loaded=False)
STREAMS = 16
WAITING = replace(LAB, name="waiting", actuators=replace(LAB.actuators, turns_loaded=False))


@dataclass(frozen=True)
class ActuatorOptions:
    """Compare success in the lab with axes that turn under load and with axes that wait."""

    tasks: tuple[str, ...] = ("sort", "slow", "stop")
    """Tasks of one parcel."""
    starts: int = 240
    """Starts of each task."""

    def __post_init__(self) -> None:
        checks.integer("starts", self.starts, least=1)


def find_methods(task: str) -> list[Method]:
    """Return the rules of a task, and its agents for the lab."""
    trained = [each for each in shipped(task) if each.name.endswith(LAB.name)]
    return [*(each for each in rules(task) if each.most is None), *trained]


def successes(method: Method, preset: Preset, starts: int) -> Booleans:
    """Return the success (seeds, starts) of a method, with the same starts for all seeds."""
    where = situation(method, start_benchmark(method.task), Change(preset))
    return np.array(
        [
            run_episodes(method.controller(where.assumed, seed), where.true, [{}] * starts, SEED)
            .success
            for seed in method.seeds
        ]
    )  # fmt: skip


def describe(success: Booleans) -> str:
    """Return the success rate with its 95 % interval."""
    low, high = interval(success)
    return f"{success.mean():.3f} ({low:.3f} to {high:.3f})"


def describe_stream(actuators: sg.Actuators) -> str:
    """Return as text the deliveries and jams of a 3.2 m line with a parcel always at its gate."""
    case = FlowCase(3000.0, (("S", 1.0), ("B", 1.0)), speed=1.5)
    config = case.config(columns=32, orientations=SIX)
    scheduler, state = make_scheduler(config), None
    assert scheduler is not None  # the line sorts every parcel
    batch = begin_streams(config.replace(actuators=actuators), STREAMS, SEED)
    while (batch.outcome == RUNNING).any():
        action, state = scheduler.predict(batch.observation, state)
        batch.step(config.action_kind.commands(action, STREAMS))
    correct, wrong = batch.streams.tally[:, [CORRECT, WRONG]].sum(axis=0)
    jams = int((batch.outcome == JAM).sum())
    return f"{correct} correct, {wrong} wrong, {jams} of {STREAMS} streams jam"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the comparison."""
    options = tyro.cli(ActuatorOptions, args=arguments, prog="python -m benchmarks.actuators")
    methods = [each for task in options.tasks for each in find_methods(task)]
    table = Table("task", "controller", title="success in the lab (95 % interval)")
    for column in ("axes turn under load", "axes wait"):
        table.add_column(column, justify="right")
    console = Console()
    for method in track(methods, console=Console(stderr=True), transient=True):
        both = (describe(successes(method, each, options.starts)) for each in (LAB, WAITING))
        table.add_row(method.task, method.name, *both)
    for name, each in (("under load", sg.Actuators()), ("only unloaded", UNLOADED)):
        console.print(f"Flow, scheduler of modules, axes turn {name}: {describe_stream(each)}")
    console.print(table)


if __name__ == "__main__":
    main()
