"""`surface-gym runtime`: a policy in real time, on a machine or on the simulator, and the report of
the run: counts and latencies, as JSON and on screen.
"""

import gc
import json
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tyro

from surface_gym.files import replacing

from ..learning.config import current_option
from .config import RuntimeConfig, parse_address

if TYPE_CHECKING:
    from rich.console import Console

    from surface_gym.config import EnvConfig

    from ..module_policy import ModulePolicy
    from ..policy import Policy
    from .controller import ControlLoop, Counts, Latencies

READY_TIMEOUT = 300.0  # [s] that fixed layouts may take to be ready, compiling included
SHOW_EVERY = 1.0  # [s] between updates of the progress
COLLECT_EVERY = 5.0  # [s] between collections of Python's garbage
FILE = "report.json"
PERCENTILES = (50.0, 90.0, 99.0, 100.0)
NAMES = ("50 %", "90 %", "99 %", "max")
STAGES = {
    "sensor": "from the latest frame to the estimate",
    "filter": "reading, estimating, observing",
    "policy": "deciding",
    "send": "until the axes began to turn",
    "turn": "until the last axis has turned, as computed",
    "whole": "from the latest frame until then",
    "late": "from when a period is due to its beginning",
    "work": "of a period, from its beginning to its end",
}


@dataclass(frozen=True)
class Run:
    """The circumstances of a run."""

    agent: str
    seed: int  # of the policy
    task: str
    preset: str  # of the machine
    device: str  # the simulator, or an address
    period: float  # [s]
    watchdog: float  # [s]
    seconds: float  # [s] that it ran
    load: tuple[float, float, float]  # of the machine at the end, over 1, 5 and 15 minutes
    cores: int  # of the machine


def percentiles(seconds: Sequence[float]) -> list[float] | None:
    """Compute `PERCENTILES` [s] of some times; None: there are none."""
    if not seconds:
        return None
    return np.percentile(np.array(seconds), PERCENTILES).tolist()


def make_report(run: Run, counts: "Counts", latencies: "Latencies") -> dict[str, Any]:
    """Return the report as it is written."""
    parcels = sum(counts.parcels.values())
    return {
        "run": asdict(run),
        "counts": {**asdict(counts), "parcels": dict(counts.parcels.most_common())},
        "success": counts.parcels["success"] / parcels if parcels else None,
        "percentiles": list(NAMES),
        "budget": {name: percentiles(getattr(latencies, name)) for name in STAGES},
    }


def write_report(report: dict[str, Any], folder: Path) -> Path:
    """Write a report into a folder, and return the file."""
    file = folder / FILE
    with replacing(file) as part:
        part.write_text(json.dumps(report, indent=2) + "\n")
    return file


def show_report(report: dict[str, Any], console: "Console") -> None:
    """Print a report."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    run, counts = report["run"], report["counts"]
    budget = Table(
        title=f"Latency in ms, beside a period of {1e3 * run['period']:g} ms",
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    budget.add_column("stage")
    for name in NAMES:
        budget.add_column(name, justify="right")
    budget.add_column("")
    for name, times in report["budget"].items():
        row = ["-"] * len(NAMES) if times is None else [f"{1e3 * each:.2f}" for each in times]
        budget.add_row(name, *row, STAGES[name])
    console.print(budget)
    for line in _sentences(run, counts, report["success"]):
        console.print(line, highlight=False, soft_wrap=True)


def _sentences(run: dict[str, Any], counts: dict[str, Any], success: float | None) -> list[str]:
    parcels = ", ".join(f"{count} {outcome}" for outcome, count in counts["parcels"].items())
    load = ", ".join(f"{each:.2f}" for each in run["load"])
    return [
        f"{run['agent']} for {run['seconds']:.0f} s: {counts['periods']} periods, "
        f"{counts['kept']} deadlines kept, {counts['missed']} missed, {counts['skipped']} periods "
        f"skipped; load {load} on {run['cores']} cores",
        f"{counts['decisions']} decisions by the policy; fixed layout in "
        f"{counts['by_fixed_layout']} periods, frames stopped for more than "
        f"{1e3 * run['watchdog']:g} ms {counts['watchdog']} times; axes held in {counts['held']}",
        f"{counts['sent']} axis commands sent, {counts['out_of_range']} out of range and not sent, "
        f"{counts['refused']} refused by the device; {counts['strayed']} observations out of "
        "bounds",
        f"{counts['frames']} frames, {counts['frames_unused']} of no use; device lost "
        f"{counts['lost']} times, found {counts['connected']} times in {counts['attempts']} "
        f"attempts, away in {counts['unconnected']} periods",
        f"{sum(counts['parcels'].values())} parcels"
        + ("" if success is None else f", success {success:.3f}: {parcels}")
        + (f"; {counts['unfit']} that do not fit" if counts["unfit"] else ""),
    ]


def load_policy(config: RuntimeConfig) -> "Policy | ModulePolicy":
    """Load the policy of a command."""
    from .. import library
    from ..policy import ParcelPolicy

    if config.name in library.names():
        policy = library.load(config.name, config.seed)
    elif Path(config.name).is_dir():
        custom = None if config.task is None else library.find_task(config.task)
        policy = library.read(config.name, custom)
    else:
        raise ValueError(
            f"name must be a folder or one of {', '.join(library.names())}, got {config.name!r}"
        )
    if isinstance(policy, ParcelPolicy):
        raise ValueError(f"name must be of one parcel at a time, got {config.name!r}")
    return policy


def make_env_config(policy: "Policy | ModulePolicy", preset: str) -> "EnvConfig":
    """Return the configuration of a policy's environment under a preset."""
    from surface_gym.config import EnvConfig

    arguments = {"task": policy.card.task, **policy.env_kwargs, "preset": preset}
    return EnvConfig(**arguments)


def simulator_arguments(config: RuntimeConfig, env_config: "EnvConfig") -> list[str]:
    """Return the arguments of the simulator's command, for a policy's environment."""
    return [
        *("--task", config.task or env_config.task.name),
        *("--preset", config.preset),
        *("--control-period", repr(env_config.control_period)),
        *("--seed", str(config.start)),
        *("--world.pause", repr(config.world.pause)),
        "--world.encoders" if config.world.encoders else "--world.no-encoders",
    ]


def run_agent(config: RuntimeConfig, console: "Console") -> None:
    """Run an agent and report on it; Ctrl-C ends the run early."""
    from surface_gym.parallel import usable_cores

    from . import controller
    from .estimator import StateEstimator
    from .protocol import SocketDevice
    from .simulator import SimulatorProcess

    policy = load_policy(config)
    env_config = make_env_config(policy, config.preset)
    config.out.mkdir(parents=True, exist_ok=True)
    clock = controller.WallClock()
    with ExitStack() as stack:
        if config.address is None:
            console.print("starting the simulator")
            arguments = simulator_arguments(config, env_config)
            log = config.out / "simulator.log"
            address = stack.enter_context(SimulatorProcess(arguments, log)).address
        else:
            address = parse_address(config.address)
        console.print("compiling")
        estimator = StateEstimator(env_config)
        arranger = stack.enter_context(controller.ProcessArranger(estimator.config))
        kind = controller.FixedLayouts(estimator.config).kind
        decider = controller.Decider(policy, env_config)
        bounds = env_config.observation_space()
        loop = controller.ControlLoop(
            SocketDevice(address, env_config.task.name, estimator.shape),
            estimator,
            decider,
            (arranger, estimator.resolver(kind)),
            controller.AxisLimits(estimator.shape, controller.allowed_angles(env_config)),
            bounds,
            clock,
            controller.LoopConfig(env_config.control_period, config.watchdog),
        )
        decider.decide(bounds.low.clip(-1.0, 1.0))  # the first decision is slow
        if not arranger.wait_until_ready(READY_TIMEOUT):
            raise ValueError(f"fixed layouts must be ready within {READY_TIMEOUT:g} s")
        begun = clock.now()
        try:
            console.print(f"ready, for {config.minutes:g} minutes; Ctrl-C ends it")
            _run(loop, 60.0 * config.minutes, console)
        except KeyboardInterrupt:
            console.print("stopped")
        seconds = clock.now() - begun
    run = Run(
        agent=config.name,
        seed=config.seed or 0,
        task=env_config.task.name,
        preset=config.preset,
        device=config.address or "simulator",
        period=env_config.control_period,
        watchdog=config.watchdog,
        seconds=seconds,
        load=os.getloadavg(),
        cores=usable_cores(),
    )
    made = make_report(run, loop.counts, loop.latencies)
    show_report(made, console)
    console.print(f"written: {write_report(made, config.out)}", soft_wrap=True)


def _run(loop: "ControlLoop", seconds: float, console: "Console") -> None:
    """Run with a progress bar; it is drawn, and garbage is collected, while there is no parcel."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from .controller import WallClock

    columns = (
        TextColumn("running"),
        BarColumn(),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
    )
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with Progress(*columns, console=console, auto_refresh=False) as progress:
            bar = progress.add_task("", total=seconds, note="")
            begun = WallClock().now()
            shown = collected = begun

            def between(now: float) -> None:
                nonlocal shown, collected
                if loop.has_parcel:
                    return
                if now - shown >= SHOW_EVERY:
                    shown = now
                    parcels = sum(loop.counts.parcels.values())
                    note = f"{parcels} parcels, {loop.counts.missed} deadlines missed"
                    progress.update(bar, completed=now - begun, note=note)
                    progress.refresh()
                elif now - collected >= COLLECT_EVERY:
                    collected = now
                    gc.collect()

            loop.run(seconds, between)
    finally:
        gc.enable()
        gc.unfreeze()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; an error ends it with one line."""
    given = map(current_option, sys.argv[1:] if arguments is None else arguments)
    config = tyro.cli(RuntimeConfig, prog="surface-gym runtime", args=list(given))
    from rich.console import Console

    try:
        run_agent(config, Console())
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped before it began")
