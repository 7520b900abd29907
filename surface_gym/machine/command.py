"""`surface-gym identify`: a surface's parameters from logs of a machine."""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from surface_gym.cli import parse_options


@dataclass(frozen=True)
class IdentifyOptions:
    """Identify a surface from logs of `surface-gym runtime --log`.

    Prints each parameter with its 95 % interval, and writes estimate.json and report.html. A
    parameter that the logs do not determine has no interval, and the report says why.
    """

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Logs of one surface."""
    free: tuple[str, ...] = ("mu_max", "mu_min", "mu_support", "quarter_turn")
    """Parameters to find: mu_max, mu_min, mu_support, tilt, quarter_turn, dead_time, latency,
    com_x, com_y.
    """
    known: Annotated[dict[str, float], tyro.conf.arg(metavar="NAME VALUE")] = field(
        default_factory=dict
    )
    """Values of others, e.g. tilt 0.05; by default as the logs assume."""
    position_noise: float | None = None
    """Standard deviation of the pictures in m; by default found from the pictures."""
    angle_noise: float | None = None
    """Standard deviation in deg."""
    dt: float = 0.001
    """Maximum step of the predictions in s."""
    out: Path = Path("runs/identify")
    """Folder for estimate.json and report.html."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. If there is an error, print it on one line and exit with status 1."""
    options = parse_options(IdentifyOptions, "identify", arguments)
    try:
        identify_and_report(options)
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped")


def identify_and_report(options: IdentifyOptions) -> None:
    """Identify a surface, print a table, and write the estimate and the report."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if (options.position_noise is None) != (options.angle_noise is None):
        raise ValueError(
            "position_noise and angle_noise must be given together, "
            f"got {options.position_noise} and {options.angle_noise}"
        )
    noise = None
    if options.position_noise is not None and options.angle_noise is not None:
        noise = options.position_noise, math.radians(options.angle_noise)
    with console.status("reading the logs") as status:
        from surface_gym.machine.estimate import describe_value, write_report
        from surface_gym.machine.identification import identify

        found = identify(
            options.logs, free=options.free, known=options.known, noise=noise, dt=options.dt,
            on_progress=status.update,
        )  # fmt: skip
    found.save(options.out / "estimate.json")
    write_report(found, options.out / "report.html")
    table = Table("parameter", "value", "95 % interval", box=SIMPLE_HEAD)
    for name in found.values:
        table.add_row(name, *describe_value(found, name))
    console.print(table)
    console.print(f"misfit {found.misfit:.2f} over {len(found.misfits)} runs")
    for each in found.warnings():
        console.print(each, style="yellow", markup=False)
    for name in ("estimate.json", "report.html"):
        console.print(f"written: {options.out / name}", markup=False, soft_wrap=True)
