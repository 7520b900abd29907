"""`surface-gym runtime`: run a policy in real time, on a machine or on the simulator.

The report of the run holds counts and latencies, as JSON and on screen.
"""

import gc
import math
import os
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlparse

from surface_gym.cli import parse_options

from .config import OPC_UA, RuntimeConfig, find_token, make_env_config, parse_address
from .report import make_report, show_report, write_report

if TYPE_CHECKING:
    from rich.console import Console

    from surface_gym.config import EnvConfig
    from surface_gym.lines import Site
    from surface_gym.parcel import Parcel

    from ..base import Controller
    from ..library import TrainedPolicy
    from .controller import ControlLoop
    from .estimator import Estimator
    from .protocol import GatedDevice, Listener

Machine = tuple[str, str | None]  # address, and the shared token
EXCITATION = "excitation"  # name of a controller that is no policy
READY_TIMEOUT = 300.0  # [s] maximum time until fixed layouts are ready, including compilation
SHOW_EVERY = 1.0  # [s] between updates of the progress
COLLECT_EVERY = 5.0  # [s] between garbage collections


def load_policy(config: RuntimeConfig) -> "TrainedPolicy":
    """Load the policy that a command names: a shipped agent, or a policy in a folder."""
    from .. import library

    if config.name in library.names():
        return library.load(config.name, config.seed)
    if Path(config.name).is_dir():
        custom = None if config.task is None else library.find_task(config.task)
        return library.read(config.name, custom)
    raise ValueError(
        f"name must be a folder, a rule of a stream as 'flow: event rule', or one of "
        f"{', '.join(library.names())}, {EXCITATION}, got {config.name!r}"
    )


def load_controller(config: RuntimeConfig) -> "tuple[Controller, EnvConfig]":
    """Load the controller that a command names, and the configuration of its environment."""
    from ..library import find_task, load, names
    from ..rules import RULES
    from .deciders import ExcitationController

    if config.name == EXCITATION:
        if config.task is None:
            raise ValueError(f"task must be given for {EXCITATION!r}, got none")
        env_config = make_env_config(config, task=find_task(config.task), actions="modules")
        if env_config.task.is_stream:
            raise ValueError(f"task must be of one parcel at a time, got {config.task!r}")
        return ExcitationController(env_config), env_config
    if config.name in RULES and find_task(RULES[config.name].task).is_stream:
        rule = RULES[config.name]
        env_config = make_env_config(config, task=rule.task, actions=rule.actions)
        return rule.make(env_config), env_config
    policy = load_policy(config)
    env_config = make_env_config(config, **{"task": policy.card.task, **policy.env_kwargs})
    if env_config.task.is_stream and config.name in names():
        return load(config.name, config.seed, env_config), env_config
    return policy, env_config


def open_listeners(
    config: RuntimeConfig, estimator: "Estimator", stack: ExitStack
) -> "list[Listener]":
    """Open the log and the telemetry that the command names. `stack` closes these listeners.

    The log and the telemetry describe the line and the environment of `estimator`.
    """
    listeners: list[Listener] = []
    env_config = estimator.config
    if config.log is not None:
        from surface_gym.machine.log import LoggedSurface, LogWriter

        from .protocol import MessageLog

        line, turn = env_config.chosen_line, 0.5 * math.pi / env_config.actuators.axis_speed
        log = LogWriter(config.log, LoggedSurface.of_line(line, turn, estimator.shape))
        stack.callback(log.close)
        is_stream = env_config.task.is_stream

        def site_of(parcel: "Parcel") -> "Site":
            return env_config.site if is_stream else line.site(parcel.base, env_config.zone)

        listeners.append(MessageLog(log, site_of, time.monotonic, is_stream))
    if config.mqtt is not None:
        from .mqtt import BrokerOptions, Telemetry

        host, port = parse_address(config.mqtt)
        broker = BrokerOptions(
            host, port, config.mqtt_user, config.mqtt_password_file, config.mqtt_ca
        )
        telemetry = Telemetry(broker, env_config.task.name)
        stack.callback(telemetry.close)
        listeners.append(telemetry)
    return listeners


def open_device(
    address: str, token: str | None, config: RuntimeConfig, task: str, shape: tuple[int, int]
) -> "GatedDevice":
    """Return the device at an address.

    The device must run the task `task`, and its widest zone must have `shape` (rows, columns). If
    `token` is not None, device and control loop prove to each other that they know the token.
    """
    from .protocol import SocketDevice

    if not address.startswith(OPC_UA):
        return SocketDevice(parse_address(address), task, shape, token)
    from .opcua import USER, OpcUaDevice, OpcUaSecurity

    if token is None:
        raise ValueError("token must be given, by --token-file or SURFACE_GYM_TOKEN, got none")
    security = OpcUaSecurity(token, urlparse(address).username or USER, config.certificates)
    return OpcUaDevice(address, task, shape, security, config.nodes)


def simulator_arguments(config: RuntimeConfig, env_config: "EnvConfig") -> list[str]:
    """Return the simulator's command-line arguments for a policy's environment."""
    world = config.world
    if env_config.task.is_stream:
        task = env_config.stream_task
        world = replace(world, gate=task.gate, most=task.max_parcels)
    arguments = [
        *("--task", config.task or env_config.task.name),
        *("--preset", config.preset),
        *(() if config.estimate is None else ("--estimate", str(config.estimate.absolute()))),
        *("--control-period", repr(env_config.control_period)),
        *("--seed", str(config.start)),
    ]
    for name, value in asdict(world).items():
        if isinstance(value, bool):
            arguments.append(f"--world.{name}" if value else f"--world.no-{name}")
        elif value is not None:
            arguments += [f"--world.{name}", repr(value)]
    return arguments


def run_agent(config: RuntimeConfig, console: "Console") -> None:
    """Run an agent and write a report."""
    from .simulator import SimulatorProcess

    policy, env_config = load_controller(config)
    config.out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        token: str | None
        address = config.address
        if address is None:
            console.print("starting the simulator")
            arguments = simulator_arguments(config, env_config)
            log = config.out / "simulator.log"
            simulator = stack.enter_context(SimulatorProcess(arguments, log))
            address, token = "{}:{}".format(*simulator.address), simulator.token
        else:
            token = find_token(config.token_file)
            if token is None:
                console.print("no token: whoever answers at the address is taken for the machine")
        console.print("compiling")
        loop = make_loop(config, policy, env_config, (address, token), stack)
        run_and_report(loop, config, env_config, console)


def make_loop(
    config: RuntimeConfig, policy: "Controller", env_config: "EnvConfig",
    machine: Machine, stack: ExitStack,
) -> "ControlLoop":  # fmt: skip
    """Make a policy's control loop, compiled and ready to run; `stack` closes the loop's parts.

    `machine` is the device's address and token, and `env_config` the policy's environment.
    """
    from .controller import ControlLoop, LoopConfig, StreamLoop
    from .deciders import FixedLayouts, ProcessArranger
    from .estimator import StateEstimator
    from .protocol import WallClock
    from .tracker import StreamTracker

    # An OPC UA device connects in its own thread; an attempt only asks whether it has.
    is_opc_ua = config.address is not None and config.address.startswith(OPC_UA)
    timing = LoopConfig(
        env_config.control_period, config.watchdog, longest_wait=0.2 if is_opc_ua else 1.0
    )
    task, is_stream = env_config.task.name, env_config.task.is_stream
    estimator: Any = StreamTracker(env_config) if is_stream else StateEstimator(env_config)
    device = open_device(*machine, config, task, estimator.shape)
    listeners = open_listeners(config, estimator, stack)
    given = (policy, env_config, WallClock(), timing, listeners)
    if is_stream:
        loop: ControlLoop = StreamLoop(device, estimator, *given)
    else:
        arranger = stack.enter_context(ProcessArranger(estimator.config))
        fixed = arranger, estimator.resolver(FixedLayouts(estimator.config).kind)
        loop = ControlLoop(device, estimator, fixed, *given)
        if not arranger.wait_until_ready(READY_TIMEOUT):
            raise ValueError(f"fixed layouts must be ready within {READY_TIMEOUT:g} s")
    loop.warm_up()
    return loop


def run_and_report(
    loop: "ControlLoop", config: RuntimeConfig, env_config: "EnvConfig", console: "Console"
) -> None:
    """Run a loop, and write a report, even after an error. Ctrl-C ends the run early."""
    from surface_gym.parallel import usable_cores

    begun = time.monotonic()
    stopped = False
    try:
        console.print(f"ready, for {config.minutes:g} minutes; Ctrl-C ends it")
        _run(loop, 60.0 * config.minutes, console)
    except KeyboardInterrupt:
        stopped = True
    finally:  # write first, since printing may fail
        run = {
            "agent": config.name,
            "seed": config.seed or 0,
            "task": env_config.task.name,
            "preset": config.preset,
            "device": config.address or "simulator",
            "period": env_config.control_period,
            "watchdog": config.watchdog,
            "seconds": time.monotonic() - begun,
            "load": os.getloadavg(),
            "cores": usable_cores(),
        }
        made = make_report(run, loop.counts, loop.latencies)
        file = write_report(made, config.out)
    if stopped:
        console.print("stopped")
    show_report(made, console)
    console.print(f"written: {file}", markup=False, soft_wrap=True)


def _run(loop: "ControlLoop", seconds: float, console: "Console") -> None:
    """Run for a time [s] with a progress bar.

    Updates of the bar and garbage collection happen only while there is no parcel.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

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
            begun = time.monotonic()
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
    """Run the command. If it fails, print the error in one line."""
    config = parse_options(RuntimeConfig, "runtime", arguments)
    from rich.console import Console

    try:
        run_agent(config, Console())
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped before it began")
