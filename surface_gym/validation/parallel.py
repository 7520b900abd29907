"""Jobs in processes of their own, with a bar."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from typing import TypeVar

from rich.console import Console
from rich.progress import track

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_all(
    executor: Executor,
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    title: str,
    console: Console,
) -> list[Result]:
    """The function's result for each job, in the order of the jobs.

    Args:
        executor: runs them.
        function: of a module, so that other processes find it.
        jobs: its arguments.
        title: what the bar says.
        console: where the bar is drawn.
    """
    futures = [executor.submit(function, job) for job in jobs]
    try:
        for future in track(
            as_completed(futures),
            title,
            total=len(futures),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        ):
            future.result()
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        raise
    return [future.result() for future in futures]
