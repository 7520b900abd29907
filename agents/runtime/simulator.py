"""`python -m agents.runtime.simulator`: a machine that is simulated, behind a socket."""

import os
import socket
import sys
from dataclasses import dataclass, field

from surface_gym.commands import run
from surface_gym.settings import Settings

from ..tasks import find_task
from .clock import WallClock
from .serving import Server, serve
from .world import World, WorldOptions

HOST = "127.0.0.1"  # this machine only: its clock is part of what is said
LISTENING = "listening on "


@dataclass(frozen=True)
class SimulatorConfig:
    """Run the physics of an environment in real time, and let a control loop connect to it."""

    task: str = "stop"
    """The task, the package's or one's own as path/to/file.py:Class."""
    condition: str = "lab"
    """What is less kind than the ideal: a name of surface_gym.conditions."""
    control_period: float = 0.04
    """Between decisions [s]: the task's limit of time counts them."""
    port: int = 0
    """On this machine; 0: any that is free, which is told."""
    seed: int = 0
    """Of all that is drawn."""
    parent: int | None = None
    """Process without which it ends; None: it does not."""
    world: WorldOptions = field(default_factory=WorldOptions)

    def settings(self) -> Settings:
        """Of the environment.

        Raises:
            ValueError: there is no such task or condition.
        """
        return Settings(
            task=find_task(self.task),
            condition=self.condition,
            control_period=self.control_period,
        )


def simulate(config: SimulatorConfig) -> None:
    """Serve until Ctrl-C, or until the parent has ended.

    Raises:
        ValueError: a setting that is not allowed.
        OSError: the port is taken.
    """
    settings = config.settings()
    clock = WallClock()
    world = World(settings, config.seed, clock.now(), config.world)
    world.advance(clock.now())  # what is slow the first time is slow now
    listener = socket.create_server((HOST, config.port))
    server = Server(world, settings.chosen_task.name, listener)
    print(f"{LISTENING}{HOST}:{listener.getsockname()[1]}", flush=True)
    try:
        serve(server, clock, lambda: config.parent in (None, os.getppid()))
    finally:
        server.close()


def main() -> None:
    """Run the command; an error ends it with one line."""
    import tyro

    config = tyro.cli(SimulatorConfig, prog=f"python -m {__package__}.simulator")
    try:
        simulate(config)
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    run(main, f"python -m {__package__}.simulator", "agents")
