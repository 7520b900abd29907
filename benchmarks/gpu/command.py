"""Measures, prints and writes what a GPU makes of the same physics."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track

from benchmarks.figure import table_of
from surface_gym.cuda.env import check_device


class NotMeasured(RuntimeError):
    """Something of ours failed while it was measured."""


def measure_device(
    lanes: Sequence[int], beside: bool, json: Path | None, picture: Path | None, console: Console
) -> None:
    """Measure, print, write; the file is written anew after each measurement, so that what takes
    minutes is not lost.

    Args:
        lanes: numbers of lanes to measure.
        beside: whether other packages are measured as well.
        json: file to write the figures to; None: none.
        picture: file to draw decisions a second against lanes in; None: none.
        console: to print on.

    Raises:
        DeviceMissing: there is no GPU, or not what it takes to use it.
        ValueError: lanes are not positive numbers.
        NotMeasured: some of it failed; the rest is printed and written before.
    """
    if not lanes or min(lanes) < 1:
        raise ValueError(f"lanes must be positive numbers, one at least, got {tuple(lanes)}")
    check_device()
    # What needs torch and a GPU's compiler.
    from benchmarks.gpu.measuring import jobs, machine
    from benchmarks.gpu.results import Results

    results = Results(machine())
    for job in track(list(jobs(lanes, beside)), "measuring", console=console, transient=True):
        try:
            job.run(results)
        # A card's memory may be too small, another package too new: the rest is measured.
        except Exception as error:
            why = f"{job.name}: {type(error).__name__}: {error}"
            (results.failed if job.ours else results.left_out).append(why)
            if job.ours:
                console.print_exception()
        if json is not None:
            results.write(json)
    console.print(results.table())
    console.print(table_of(results.figures(), results.machine))
    for line in results.left_out:
        console.print(f"left out, {line}", markup=False)
    if picture is not None:
        from benchmarks.gpu.picture import draw

        draw(results.rates, picture)
    if results.failed:
        raise NotMeasured("; ".join(results.failed))
