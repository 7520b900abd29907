"""The command `surface-gym paper`. It imports the computation only when it runs."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from surface_gym.cli import parse_options


@dataclass(frozen=True)
class PaperOptions:
    """Reproduce the tables and figures of Bianchi et al. (2023), Applied Sciences 13(3), 1937.

    Prints Tables 2, 3 and 4, the slowing ratios, the stopping rule and the sorting rates of Figure
    8. Every value of the paper stands beside our value at a time step of 5 ms and our converged
    value. We infer that the paper's time step is 5 ms. The report counts the values that agree, and
    the steps in which Eq. (1) has no solution. It then counts agreement at other time steps, and
    tests two claims: the steepest tilt at which a box stops by itself, and alignment by axes at
    +-45 deg. The command takes 12 s on one core, or 18 s with an empty compile cache.
    """

    figures: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Draw Figures 7, 8 and 10 and the alignment into this folder, as PNG and PDF."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write every number to this file."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. If a file cannot be written, exit with an error of one line."""
    options = parse_options(PaperOptions, "paper", arguments)
    from surface_gym.paper import report, reproduction

    try:
        # Check that the paths are writable before the long computation.
        if options.json is not None:
            options.json.open("a").close()
        if options.figures is not None:
            options.figures.mkdir(parents=True, exist_ok=True)
        with Console(stderr=True).status("") as status:
            found = reproduction.reproduce(status.update)
        report.print_report(found, Console())
        if options.json is not None:
            options.json.write_text(reproduction.to_json(found), encoding="utf-8")
        if options.figures is not None:
            print(*report.draw_figures(found, options.figures), sep="\n")
    except OSError as error:
        sys.exit(f"error: cannot write {error.filename}: {error.strerror}")
