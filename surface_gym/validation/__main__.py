"""`python -m surface_gym.validation`, the same as `surface-gym validation`."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from surface_gym.cli import parse_options, run_command
from surface_gym.executors import WorkError
from surface_gym.parallel import choose_workers, usable_cores


@dataclass(frozen=True)
class ValidationOptions:
    """Compare the analytic model with MuJoCo, as Section 6 of the paper compares it with Adams.

    Prints Table 7 for Adams and for MuJoCo, Adams's displacements where the paper states them, the
    smallest tilt that completes the sort, the convergence of MuJoCo, and the speed of each method.
    Takes about a minute on two cores, two minutes more with --heights, and ten minutes more with
    --touching.
    """

    figures: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Draw the content of Figures 12 and 14 to 16 into this folder, as PNG."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write every number to this file."""
    heights: bool = False
    """Also study supports that differ by micrometres in height, or in stiffness."""
    touching: bool = False
    """Also study parcels that push each other: two that meet, and crowds held and released."""
    workers: int = usable_cores()
    """Number of parallel processes."""
    cluster: str | None = None
    """Address of a Ray cluster to use instead; "auto" for a local cluster."""
    tilts: tuple[float, ...] = tuple(5.0 + 0.25 * k for k in range(37))
    """Tilts of the sweep [deg], within Table 5's 5 to 15."""
    seed: int = 0
    """Seed of the random supports and parcels."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. If there is an error, print it on one line and exit with status 2."""
    settings = (tyro.conf.FlagCreatePairsOff,)
    options = parse_options(ValidationOptions, "validation", arguments, config=settings)
    try:
        compare(options)
    except ModuleNotFoundError:
        raise  # `surface_gym.cli` says what to install
    except (ValueError, RuntimeError, OSError, ImportError, WorkError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def compare(options: ValidationOptions) -> None:
    """Check the options, run the comparison, print its results and write the requested files."""
    import json

    from rich.console import Console

    from surface_gym import checks
    from surface_gym.validation.simulation import load_mujoco

    workers = choose_workers(options.cluster, options.workers)
    checks.integer("seed", options.seed, least=0)
    if not options.tilts:
        raise ValueError("tilts must be at least one, got none")
    for tilt in options.tilts:
        checks.within("tilts", tilt, 5.0, 15.0)
    load_mujoco()
    from surface_gym.validation import report

    if options.figures is not None:
        options.figures.mkdir(parents=True, exist_ok=True)
    if options.json is not None:
        options.json.open("a").close()  # fail before the runs
    study = report.run_study(
        options.tilts, options.heights, options.touching, workers, options.seed,
        Console(stderr=True),
    )  # fmt: skip
    report.print_report(study, Console())
    if options.json is not None:
        options.json.write_text(json.dumps(report.as_data(study), indent=2) + "\n", "utf-8")
    if options.figures is not None:
        for path in report.draw_all(study, options.figures):
            print(path)


if __name__ == "__main__":
    run_command("validation")
