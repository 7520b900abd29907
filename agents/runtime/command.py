"""`python -m agents.runtime`: a policy in real time, on a machine or on the simulator."""

import gc
import os
import sys
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from surface_gym import checks
from surface_gym.cores import usable_cores
from surface_gym.settings import Settings

from .. import library
from ..flow.policy import FlowPolicy
from ..modules.policy import ModulesPolicy
from ..policies.policy import Policy
from ..tasks import find_task
from .arranging import ArrangedApart
from .axis_guard import AxisGuard
from .clock import WallClock
from .deciding import Decider, FixedLayouts, bounds_of, on_offer
from .loop import Loop, LoopConfig
from .report import Run, report_of, show_report, write_report
from .shadow import Shadow
from .socket_device import SocketDevice, address_of
from .supervising import Drill, SimulatorProcess
from .world import WorldOptions

READY = 300.0  # [s] that fixed layouts may take to be ready, compiling included
SHOW = 1.0  # [s] from one look at the progress to the next
COLLECT = 5.0  # [s] between collections of what Python left behind


@dataclass(frozen=True)
class RuntimeConfig:
    """Run an agent in real time: on the simulator, in a process of its own, or at an address."""

    name: tyro.conf.Positional[str]
    """Of a shipped agent, as stop-ppo; or the folder of a policy that a run has left."""
    seed: int | None = None
    """Of a shipped agent's policies; None: the first."""
    task: str | None = None
    """Of one's own that the policy was trained on, as path/to/file.py:Class."""
    minutes: float = 10.0
    """To run for."""
    condition: str = "lab"
    """What the machine is like, by a name of surface_gym.conditions: the filter's friction, noise
    and turning axes are its, and so is the simulator."""
    address: str | None = None
    """Of a device that runs already, host:port; None: begin the simulator."""
    watchdog: float = 0.2
    """Seconds without a frame after which the fixed layout stands in."""
    kill_every: float = 0.0
    """Seconds after which the simulator is killed and begun again, as a drill; 0: never."""
    start: int = 0
    """Seed of the simulator's parcels and noise."""
    world: WorldOptions = field(default_factory=WorldOptions)
    """Of the simulator."""
    out: Path = Path("runs/runtime")
    """Folder for report.json and the simulator's log."""

    def __post_init__(self) -> None:
        checks.positive("minutes", self.minutes)
        checks.positive("watchdog", self.watchdog)
        checks.not_negative("kill_every", self.kill_every)
        if self.address is not None:
            address_of(self.address)
            if self.kill_every:
                raise ValueError("kill_every must be 0 beside an address: it is not ours to kill")


def policy_of(config: RuntimeConfig) -> Policy | ModulesPolicy:
    """The policy that is asked for.

    Raises:
        ValueError: there is none, or it is one for streams of parcels.
    """
    if config.name in library.names():
        policy = library.load(config.name, config.seed)
    elif Path(config.name).is_dir():
        own = None if config.task is None else find_task(config.task)
        policy = library.read(config.name, own)
    else:
        raise ValueError(
            f"name must be a folder or one of {', '.join(library.names())}, got {config.name!r}"
        )
    if isinstance(policy, FlowPolicy):
        raise ValueError(f"name must be of one parcel at a time, got {config.name!r}")
    return policy


def settings_of(policy: Policy | ModulesPolicy, condition: str) -> Settings:
    """Those of the environment that a policy is for, under a condition.

    Raises:
        ValueError: there is no such condition.
    """
    arguments = {"task": policy.card.task, **policy.env_kwargs, "condition": condition}
    return Settings(**arguments)


def simulator_arguments(config: RuntimeConfig, settings: Settings) -> list[str]:
    """Of the simulator's command, for the environment of a policy."""
    world = config.world
    return [
        *("--task", config.task or settings.chosen_task.name),
        *("--condition", config.condition),
        *("--control-period", repr(settings.control_period)),
        *("--seed", str(config.start)),
        *("--world.pause", repr(world.pause)),
        *("--world.mute-every", repr(world.mute_every)),
        *("--world.mute-for", repr(world.mute_for)),
        "--world.encoders" if world.encoders else "--world.no-encoders",
    ]


def run_agent(config: RuntimeConfig, console: Console) -> None:
    """Run, and tell what came of it; Ctrl-C ends it early.

    Raises:
        ValueError: a setting that is not allowed, or a simulator that does not begin.
    """
    policy = policy_of(config)
    settings = settings_of(policy, config.condition)
    config.out.mkdir(parents=True, exist_ok=True)
    clock = WallClock()
    with ExitStack() as stack:
        process = None
        if config.address is None:
            console.print("the simulator begins")
            arguments = simulator_arguments(config, settings)
            process = SimulatorProcess(arguments, config.out / "simulator.log")
            stack.enter_context(process)
            address = process.address
        else:
            address = address_of(config.address)
        console.print("compiling")
        shadow = Shadow(settings)
        arranger = stack.enter_context(ArrangedApart(shadow.settings))
        kind = FixedLayouts(shadow.settings).kind
        decider = Decider(policy, settings)
        loop = Loop(
            SocketDevice(address, settings.chosen_task.name, shadow.shape),
            shadow,
            decider,
            (arranger, shadow.resolver(kind)),
            AxisGuard(shadow.shape, on_offer(settings)),
            bounds_of(settings),
            clock,
            LoopConfig(settings.control_period, config.watchdog),
        )
        decider.decide(bounds_of(settings).low.clip(-1.0, 1.0))  # the first decision is slow
        if not arranger.wait_until_ready(READY):
            raise ValueError(f"fixed layouts must be ready within {READY:g} s")
        begun = clock.now()
        drill = None if process is None else Drill(process, config.kill_every, begun)
        try:
            console.print(f"ready, for {config.minutes:g} minutes; Ctrl-C ends it")
            _run(loop, 60.0 * config.minutes, drill, console)
        except KeyboardInterrupt:
            console.print("stopped")
        seconds = clock.now() - begun
    loop.counts.kills = 0 if drill is None else drill.kills
    run = Run(
        agent=config.name,
        seed=config.seed or 0,
        task=settings.chosen_task.name,
        condition=config.condition,
        device=config.address or "simulator",
        period=settings.control_period,
        watchdog=config.watchdog,
        seconds=seconds,
        load=os.getloadavg(),
        cores=usable_cores(),
    )
    report = report_of(run, loop.counts, loop.latencies)
    show_report(report, console)
    console.print(f"written: {write_report(report, config.out)}", soft_wrap=True)


def _run(loop: Loop, seconds: float, drill: Drill | None, console: Console) -> None:
    """Run with a bar, which is drawn between periods; so is what Python leaves behind collected,
    while no parcel is on the surface.
    """
    columns = (
        TextColumn("running"),
        BarColumn(),
        TextColumn("{task.fields[told]}"),
        TimeElapsedColumn(),
    )
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with Progress(*columns, console=console, auto_refresh=False) as progress:
            bar = progress.add_task("", total=seconds, told="")
            begun = WallClock().now()
            shown = collected = begun

            def between(now: float) -> None:
                nonlocal shown, collected
                if drill is not None:
                    drill.turn(now)
                if loop.has_parcel:
                    return
                if now - shown >= SHOW:
                    shown = now
                    counts = loop.counts
                    told = (
                        f"{sum(counts.parcels.values())} parcels, {counts.missed} deadlines missed"
                    )
                    progress.update(bar, completed=now - begun, told=told)
                    progress.refresh()
                elif now - collected >= COLLECT:
                    collected = now
                    gc.collect()

            loop.run(seconds, between)
    finally:
        gc.enable()
        gc.unfreeze()


def main() -> None:
    """Run the command; an error ends it with one line."""
    config = tyro.cli(RuntimeConfig, prog=f"python -m {__package__}")
    try:
        run_agent(config, Console())
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped before it began")
