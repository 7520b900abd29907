"""`python train.py --search sweep.yml`: a new search, or one to go on with."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from surface_gym.sharing import Tell, Workers, check_workers, share
from surface_gym.whole_files import replacing

from ..programs import TRAIN, typed
from .sweep import Sweep, differences, read_sweep
from .tried import Tried, best_of, read_tried, write_tried

if TYPE_CHECKING:
    from .study import Order

FILE = "sweep.yml"  # in a search's folder


def search(
    file: Path, folder: Path, workers: Workers, console: Console, task: str | None = None
) -> None:
    """Search hyper-parameters and leave a report in a folder, or go on with a search there.

    Args:
        file: what to search, as `Sweep` has it.
        folder: of the search; one that holds the same search is gone on with.
        workers: that the trials of a generation are shared among.
        console: to tell how far it is.
        task: of one's own that the search is of; None: one of the package.

    Raises:
        ValueError: Optuna is missing, the file is not understood, or the folder holds another
            search or something else.
    """
    check_workers(workers)
    if find_spec("optuna") is None:
        raise ValueError(
            "search needs optuna, which is not installed: pip install 'surface_gym[search]'"
        )
    # They bring Optuna with them.
    from .report import BEST, PAGE, summary, write_report
    from .trial import run_trial

    sweep = open_search(file, folder, task)
    try:
        trials = go_on(sweep, folder, workers, console, run_trial)
    except KeyboardInterrupt:
        kept = len(read_tried(folder))
        console.print(
            f"interrupted: {folder} holds {kept} trials; "
            f"{typed(TRAIN, '--resume', str(folder))} goes on with it",
            soft_wrap=True,
        )
        return
    write_report(sweep, trials, folder)
    console.print(summary(sweep, trials))
    best = "" if best_of(trials) is None else f" and {BEST}"
    console.print(f"{folder} holds {PAGE}{best}", soft_wrap=True)


def open_search(file: Path, folder: Path, task: str | None = None) -> Sweep:
    """What to search, kept in its folder, which is made where there is none.

    Raises:
        ValueError: the file is not understood, or the folder holds another search or something
            else.
    """
    sweep = read_sweep(file, task)
    kept = folder / FILE
    if kept.is_file():
        before = read_sweep(kept, task)
        if found := differences(before, sweep):
            raise ValueError(f"folder must be of this search, got {folder}: {'; '.join(found)}")
        return before
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"folder must be new, or a search's, got {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(kept) as part:
        part.write_text(file.read_text())
    return sweep


def go_on(
    sweep: Sweep,
    folder: Path,
    workers: Workers,
    console: Console,
    carry: "Callable[[Order, Tell], Tried]",
) -> list[Tried]:
    """Carry out the trials of a search that its folder does not hold yet, and keep each there.

    Args:
        sweep: what to search.
        folder: of the search.
        workers: that the trials of a generation are shared among.
        console: to tell how far it is.
        carry: a trial out; a function of a module, so that another process finds it.

    Returns:
        All trials, by number.

    Raises:
        ValueError: the folder holds trials that are not this search's.
    """
    from .study import carry_out

    kept = read_tried(folder)
    with _bars(console) as bars:
        whole = bars.add_task("trials", total=sweep.trials, completed=len(kept), told=_best(kept))

        def work(orders: "Sequence[Order]") -> Iterator[Tried]:
            rows = [
                bars.add_task(f"trial {order.number}", total=sweep.looks, told="-")
                for order in orders
            ]

            def heard(place: int, look: tuple[int, float]) -> None:
                bars.update(rows[place], completed=look[0], told=f"{sweep.metric} {look[1]:.3f}")

            jobs = [partial(carry, order) for order in orders]
            for place, tried in share(jobs, workers, heard):
                kept[tried.number] = tried
                write_tried(kept.values(), folder)
                bars.remove_task(rows[place])
                bars.update(whole, completed=len(kept), told=_best(kept))
                yield tried

        return carry_out(sweep, dict(kept), work)


def _bars(console: Console) -> Bars:
    return Bars(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f}"),
        TextColumn("{task.fields[told]}"),
        TimeElapsedColumn(),
        console=console,
    )


def _best(kept: Mapping[int, Tried]) -> str:
    best = best_of(kept.values())
    return "-" if best is None else f"best {best.value:.3f}, trial {best.number}"
