"""The command line of `python -m surface_gym.validation`."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from surface_gym.cli import typed
from surface_gym.parallel import WorkFailed, choose_workers, usable_cores


@dataclass(frozen=True)
class Options:
    """Compare the analytic model with MuJoCo, as Section 6 of the paper does with Adams.

    Prints Table 7 for Adams as printed and for MuJoCo, Adams's displacements as far as they are
    printed, from which tilt the sort completes, how far MuJoCo itself has converged, and how fast
    each method is. Takes about a minute on two cores, with --heights two more, with --touching
    eight.
    """

    figures: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Draw the content of Figures 12 to 16 into this folder, as PNG."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write every number to this file."""
    heights: bool = False
    """Study supports that differ by micrometres in height, or in stiffness, as well."""
    touching: bool = False
    """Study parcels that push each other as well: two that meet, and crowds held and let go."""
    workers: int = usable_cores()
    """Processes that run at once."""
    cluster: str | None = None
    """Address of a Ray cluster to run on instead, "auto" for this machine's."""
    tilts: tuple[float, ...] = tuple(5.0 + 0.25 * k for k in range(37))
    """Tilts of the sweep [deg], within Table 5's 5 to 15."""
    seed: int = 0
    """Of the drawn supports and parcels."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command; an error ends it with one line and status 2."""
    options = tyro.cli(
        Options,
        prog=typed("validation"),
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    try:
        compare(options)
    except ModuleNotFoundError:
        raise  # `surface_gym.cli` says what to install
    except (ValueError, RuntimeError, OSError, ImportError, WorkFailed) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def compare(options: Options) -> None:
    """Check the options, run the comparison, print it and write the files asked for."""
    import json

    from rich.console import Console

    from surface_gym import checks
    from surface_gym.validation.report import as_data, print_report
    from surface_gym.validation.simulation import load_mujoco
    from surface_gym.validation.study import run_study

    workers = choose_workers(options.cluster, options.workers)
    checks.integer("seed", options.seed, least=0)
    if not options.tilts:
        raise ValueError("tilts must be at least one, got none")
    for tilt in options.tilts:
        checks.within("tilts", tilt, 5.0, 15.0)
    load_mujoco()
    if options.figures is not None:
        options.figures.mkdir(parents=True, exist_ok=True)
        from surface_gym.validation.report import draw_all
    if options.json is not None:
        options.json.open("a").close()  # fails now rather than after the runs
    progress = Console(stderr=True)
    study = run_study(
        options.tilts, options.heights, options.touching, workers, options.seed, progress
    )
    print_report(study, Console())
    if options.json is not None:
        options.json.write_text(json.dumps(as_data(study), indent=2) + "\n", "utf-8")
    if options.figures is not None:
        for path in draw_all(study, options.figures):
            print(path)
