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
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlparse

from surface_gym.cli import parse_options

from .config import OPC_UA, RuntimeConfig, find_token, parse_address
from .report import RunConditions, make_report, show_report, write_report

if TYPE_CHECKING:
    from rich.console import Console

    from surface_gym.config import EnvConfig

    from ..base import Controller
    from ..library import TrainedPolicy
    from .controller import ControlLoop, LoopConfig
    from .estimator import StateEstimator
    from .mqtt import TelemetryDevice
    from .protocol import Device, GatedDevice

Machine = tuple[str, str | None]  # address, and the shared token
EXCITATION = "excitation"  # name of a controller that is no policy
READY_TIMEOUT = 300.0  # [s] maximum time until fixed layouts are ready, including compilation
SHOW_EVERY = 1.0  # [s] between updates of the progress
COLLECT_EVERY = 5.0  # [s] between garbage collections


def load_policy(config: RuntimeConfig) -> "TrainedPolicy":
    """Load the policy of a command."""
    from .. import library

    if config.name in library.names():
        policy = library.load(config.name, config.seed)
    elif Path(config.name).is_dir():
        custom = None if config.task is None else library.find_task(config.task)
        policy = library.read(config.name, custom)
    else:
        raise ValueError(
            f"name must be a folder, a rule of a stream as 'flow: event rule', or one of "
            f"{', '.join(library.names())}, {EXCITATION}, got {config.name!r}"
        )
    return policy


def make_env_config(policy: "TrainedPolicy", preset: str) -> "EnvConfig":
    """Return the configuration of a policy's environment under a preset."""
    from surface_gym.config import EnvConfig

    arguments = {"task": policy.card.task, **policy.env_kwargs, "preset": preset}
    return EnvConfig(**arguments)


def load_controller(config: RuntimeConfig) -> "tuple[Controller, EnvConfig]":
    """Load the controller of a command and its environment."""
    from surface_gym.config import EnvConfig

    from ..library import find_task, load, names
    from ..rules import RULES

    if config.name in RULES and find_task(RULES[config.name].task).is_stream:
        rule = RULES[config.name]
        env_config = EnvConfig(rule.task, actions=rule.actions, preset=config.preset)
        return rule.make(env_config), env_config
    if config.name != EXCITATION:
        policy = load_policy(config)
        env_config = make_env_config(policy, config.preset)
        if env_config.task.is_stream and config.name in names():
            return load(config.name, config.seed, env_config), env_config
        return policy, env_config
    from .recording import ExcitationController

    if config.task is None:
        raise ValueError(f"task must be given for {EXCITATION!r}, got none")
    task = find_task(config.task)
    env_config = EnvConfig(task, preset=config.preset, actions="modules")
    if env_config.task.is_stream:
        raise ValueError(f"task must be of one parcel at a time, got {config.task!r}")
    return ExcitationController(env_config), env_config


def open_log(
    config: RuntimeConfig, device: "Device", estimator: "StateEstimator", stack: ExitStack
) -> "Device":
    """Return the device, with a log of its messages if one is asked for."""
    if config.log is None:
        return device
    from surface_gym.machine.log import LoggedSurface, LogWriter

    from .recording import LoggedDevice

    env_config = estimator.config
    line, turn = env_config.chosen_line, 0.5 * math.pi / env_config.actuators.axis_speed
    log = LogWriter(config.log, LoggedSurface.of_line(line, turn, estimator.shape))
    stack.callback(log.close)
    return LoggedDevice(
        device, log, lambda parcel: line.site(parcel.base, env_config.zone), time.monotonic
    )


def open_device(
    address: str, token: str | None, config: RuntimeConfig, task: str, shape: tuple[int, int]
) -> "GatedDevice":
    """Return the device at an address."""
    from .protocol import SocketDevice

    if not address.startswith(OPC_UA):
        return SocketDevice(parse_address(address), task, shape, token)
    from .opcua import USER, OpcUaDevice, OpcUaSecurity

    if token is None:
        raise ValueError("token must be given, by --token-file or SURFACE_GYM_TOKEN, got none")
    security = OpcUaSecurity(token, urlparse(address).username or USER, config.certificates)
    return OpcUaDevice(address, task, shape, security, config.nodes)


def open_telemetry(
    config: RuntimeConfig, device: "Device", task: str, stack: ExitStack
) -> "TelemetryDevice | None":
    """Return the device with telemetry of its messages, if it is asked for."""
    if config.mqtt is None:
        return None
    from .mqtt import BrokerOptions, Telemetry, TelemetryDevice

    host, port = parse_address(config.mqtt)
    options = BrokerOptions(host, port, config.mqtt_user, config.mqtt_password_file, config.mqtt_ca)
    telemetry = Telemetry(options, task)
    stack.callback(telemetry.close)
    return TelemetryDevice(device, telemetry)


def simulator_arguments(config: RuntimeConfig, env_config: "EnvConfig") -> list[str]:
    """Return the arguments of the simulator's command, for a policy's environment."""
    of_stream: list[str] = []
    if env_config.task.is_stream:
        world, task = config.world, env_config.stream_task
        options = {name: getattr(world, name) for name in ("late", "lost", "false", "merged")}
        options |= {"shift": world.shift, "rate": world.rate, "most": task.max_parcels}
        for name, value in options.items():
            of_stream += [f"--world.{name}", repr(value)]
        of_stream.append("--world.gate" if task.gate else "--world.no-gate")
    return [
        *of_stream,
        *("--task", config.task or env_config.task.name),
        *("--preset", config.preset),
        *("--control-period", repr(env_config.control_period)),
        *("--seed", str(config.start)),
        *("--world.pause", repr(config.world.pause)),
        "--world.encoders" if config.world.encoders else "--world.no-encoders",
    ]


def run_agent(config: RuntimeConfig, console: "Console") -> None:
    """Run an agent and write a report."""
    from .simulator import SimulatorProcess

    policy, env_config = load_controller(config)
    if env_config.task.is_stream and config.log is not None:
        raise ValueError(f"log must be left out for a stream of parcels, got {str(config.log)!r}")
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
        make = make_stream_loop if env_config.task.is_stream else make_loop
        loop = make(config, policy, env_config, (address, token), stack)
        run_and_report(loop, config, env_config, console)


def make_loop(
    config: RuntimeConfig, policy: "Controller", env_config: "EnvConfig",
    machine: Machine, stack: ExitStack,
) -> "ControlLoop":  # fmt: skip
    """Make the loop of a policy for one parcel at a time, ready to run."""
    from . import controller
    from .estimator import StateEstimator

    estimator = StateEstimator(env_config)
    arranger = stack.enter_context(controller.ProcessArranger(estimator.config))
    kind = controller.FixedLayouts(estimator.config).kind
    decider = controller.Decider(policy, env_config)
    bounds = env_config.observation_space()
    task = env_config.task.name
    machine_device = open_device(*machine, config, task, estimator.shape)
    device = open_log(config, machine_device, estimator, stack)
    telemetry = open_telemetry(config, device, task, stack)
    loop = controller.ControlLoop(
        telemetry or device,
        estimator,
        decider,
        (arranger, estimator.resolver(kind)),
        controller.AxisLimits(estimator.shape, controller.allowed_angles(env_config)),
        bounds,
        controller.WallClock(),
        make_loop_config(config, env_config),
    )
    if telemetry is not None:
        telemetry.attach(loop.counts, loop.latencies)
    decider.decide(bounds.low.clip(-1.0, 1.0))  # warm-up, since the first decision is slow
    if not arranger.wait_until_ready(READY_TIMEOUT):
        raise ValueError(f"fixed layouts must be ready within {READY_TIMEOUT:g} s")
    return loop


def make_stream_loop(
    config: RuntimeConfig, policy: "Controller", env_config: "EnvConfig",
    machine: Machine, stack: ExitStack,
) -> "ControlLoop":  # fmt: skip
    """Make the loop of a policy for a stream, ready to run."""
    from . import controller
    from .stream_loop import StreamLoop
    from .tracker import StreamTracker

    tracker = StreamTracker(env_config)
    decider = controller.Decider(policy, env_config)
    bounds = env_config.observation_space()
    decider.decide(0.0 * bounds.low)  # warm-up: an empty table
    decider.reset()
    task = env_config.task.name
    device = open_device(*machine, config, task, tracker.shape)
    telemetry = open_telemetry(config, device, task, stack)
    loop = StreamLoop(
        telemetry or device,
        tracker,
        decider,
        controller.AxisLimits(tracker.shape, controller.allowed_angles(env_config)),
        bounds,
        controller.WallClock(),
        make_loop_config(config, env_config),
    )
    if telemetry is not None:
        telemetry.attach(loop.counts, loop.latencies)
    return loop


def make_loop_config(config: RuntimeConfig, env_config: "EnvConfig") -> "LoopConfig":
    """Return the timing of the loop."""
    from .controller import LoopConfig

    # An OPC UA device connects in its own thread; an attempt only asks whether it has.
    is_opc_ua = config.address is not None and config.address.startswith(OPC_UA)
    longest_wait = 0.2 if is_opc_ua else 1.0
    return LoopConfig(env_config.control_period, config.watchdog, longest_wait=longest_wait)


def run_and_report(
    loop: "ControlLoop", config: RuntimeConfig, env_config: "EnvConfig", console: "Console"
) -> None:
    """Run a loop, and report on it even after errors; Ctrl-C ends it early."""
    from surface_gym.parallel import usable_cores

    begun = time.monotonic()
    stopped = False
    try:
        console.print(f"ready, for {config.minutes:g} minutes; Ctrl-C ends it")
        _run(loop, 60.0 * config.minutes, console)
    except KeyboardInterrupt:
        stopped = True
    finally:  # write first, since printing may fail
        run = RunConditions(
            agent=config.name,
            seed=config.seed or 0,
            task=env_config.task.name,
            preset=config.preset,
            device=config.address or "simulator",
            period=env_config.control_period,
            watchdog=config.watchdog,
            seconds=time.monotonic() - begun,
            load=os.getloadavg(),
            cores=usable_cores(),
        )
        made = make_report(run, loop.counts, loop.latencies)
        file = write_report(made, config.out)
    if stopped:
        console.print("stopped")
    show_report(made, console)
    console.print(f"written: {file}", markup=False, soft_wrap=True)


def _run(loop: "ControlLoop", seconds: float, console: "Console") -> None:
    """Run with a progress bar, which is updated (with garbage collection) between parcels."""
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
    """Run the command; an error prints one line."""
    config = parse_options(RuntimeConfig, "runtime", arguments)
    from rich.console import Console

    try:
        run_agent(config, Console())
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped before it began")
