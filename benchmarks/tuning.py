"""`python -m benchmarks.tuning`: agents trained on identified surfaces, compared with lab agents.

Hidden surfaces are drawn as in `benchmarks.identification`, without a tilt. Each one is identified
from its log, and PPO is trained on the estimate with the defaults for the lab. Then the trained
agent and the shipped lab agents run on the hidden surface, with the lab's parcels and entries.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

import surface_gym as sg
from benchmarks.identification import HiddenSurface, Recording, record
from surface_gym.agents.evaluation.method import Method, of_run, shipped
from surface_gym.agents.evaluation.results import Results, compute
from surface_gym.agents.evaluation.scenario import STARTS, make_jobs, start_scenarios
from surface_gym.agents.learning import config as configs
from surface_gym.agents.learning.runs import make_folder, train_seeds
from surface_gym.agents.library import CARD

FREE = ("mu_max", "mu_min", "mu_support", "quarter_turn", "latency")
LAB = "lab"


@dataclass(frozen=True)
class TuningOptions:
    """Identify hidden surfaces, train agents on the estimates, and compare agents."""

    tasks: tuple[str, ...] = ("slow", "stop")
    """Tasks of one parcel with a shipped agent for the lab."""
    surfaces: tuple[int, ...] = (1, 2)
    """Seeds of the hidden surfaces."""
    steps: int | None = None
    """Control periods of a training. By default, as many as for the shipped agent."""
    out: Path = Path("runs/tuning")
    """Folder of estimates and runs."""


def identify(seed: int, out: Path) -> tuple[sg.Estimate, sg.Estimate]:
    """Return the estimate of a hidden surface from its log, and the truth in the same form."""
    rng = np.random.default_rng(seed)
    hidden = replace(HiddenSurface.draw(rng), tilt=0.0, com_x=0.0, com_y=0.0)
    file = out / f"surface-{seed}.json"
    if not file.is_file():
        log = record(hidden, Recording(), rng)
        out.mkdir(parents=True, exist_ok=True)
        sg.identify([log], free=FREE).save(file)
    found = sg.Estimate.load(file)
    true = {name: getattr(hidden, name) for name in FREE}
    exact = {name: (value, value) for name, value in true.items()}
    return found, replace(found, values=true, intervals=exact)


def train(task: str, seed: int, options: TuningOptions, console: Console) -> Method:
    """Train an agent on the estimate of a surface, unless it is trained already."""
    name = f"{task}-{seed}"
    folder = options.out / name
    if not (folder / CARD).is_file():
        config = replace(
            configs.defaults(task, "ppo", preset=LAB),
            estimate=options.out / f"surface-{seed}.json",
            out=options.out,
            name=name,
            **({} if options.steps is None else {"steps": options.steps}),
        )
        train_seeds(config, folder if folder.is_dir() else make_folder(config, ()), console, 1)
    return of_run(folder)


def compare(task: str, agent: Method, truth: sg.Estimate) -> Results:
    """Run the trained agent and the shipped lab agents on the true surface."""
    lab = [each for each in shipped(task) if each.name.endswith(LAB)]
    methods = [replace(each.under(LAB), estimate=truth) for each in (*lab, agent)]
    return Results(compute(make_jobs(start_scenarios(task), methods), 1))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the comparison; a second run continues the first."""
    options = tyro.cli(TuningOptions, prog="python -m benchmarks.tuning", args=arguments)
    console = Console(stderr=True)
    table = Table("surface", "task", "agent", "success", "95 %", box=SIMPLE_HEAD)
    for seed in options.surfaces:
        with console.status(f"identifying surface {seed}"):
            found, truth = identify(seed, options.out)
        text = ", ".join(
            f"{name} {found.values[name]:.4f} ({true:.4f})" for name, true in truth.values.items()
        )
        console.print(f"surface {seed}, found (true): {text}")
        for task in options.tasks:
            agent = train(task, seed, options, console)
            for name, sample in compare(task, agent, truth).at(task, STARTS, LAB).items():
                low, high = sample.interval
                table.add_row(
                    str(seed), task, name, f"{sample.rate:.3f}", f"{low:.3f} to {high:.3f}"
                )
    Console().print(table)


if __name__ == "__main__":
    main()
