"""The cells of a comparison, shared among processes; what is computed is kept."""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from agents.evaluation.cell import Cell, compute
from agents.evaluation.conditions import CONDITIONS
from agents.evaluation.contenders import Contender

FILE = "cells.jsonl"


def orders(contenders: Sequence[Contender]) -> list[tuple[Contender, int, str]]:
    """Every contender, seed and condition to compute; the slowest first, to fill the cores."""
    found = [
        (contender, seed, condition.name)
        for contender in contenders
        for seed in contender.seeds
        for condition in CONDITIONS
        if contender.conditions is None or condition.name in contender.conditions
    ]
    return sorted(found, key=lambda order: order[0].starts is None)


def compute_cells(
    contenders: Sequence[Contender],
    workers: int,
    folder: Path | None = None,
    advance: Callable[[int, int, str], None] = lambda *_: None,
) -> list[Cell]:
    """Compute the cells of all contenders, in an order that does not depend on the processes.

    Args:
        contenders: to compare.
        workers: processes to share the work among.
        folder: cells are kept in its cells.jsonl, and those found there are not computed again.
        advance: called with cells done, cells in all and the name of the latest.
    """
    todo = orders(contenders)
    wanted = [(who.task, who.name, condition, seed) for who, seed, condition in todo]
    found = {}
    if folder is not None:
        found = {cell.key: cell for cell in read_cells(folder)}
        # A line that was broken off must not spoil the next.
        (folder / FILE).write_text("".join(map(_line, found.values())))
    left = [order for order, key in zip(todo, wanted, strict=True) if key not in found]
    for done, cell in enumerate(_computed(left, workers), len(todo) - len(left) + 1):
        found[cell.key] = cell
        if folder is not None:
            with (folder / FILE).open("a") as file:
                file.write(_line(cell))
        advance(done, len(todo), f"{cell.task}, {cell.contender}, {cell.condition}")
    order = {(who.task, who.name): k for k, who in enumerate(contenders)}
    places = {condition.name: k for k, condition in enumerate(CONDITIONS)}
    return sorted(
        (found[key] for key in wanted),
        key=lambda cell: (order[cell.key[:2]], places[cell.condition], cell.seed),
    )


def read_cells(folder: Path) -> list[Cell]:
    """The cells kept in a folder, a last line left out that was broken off."""
    file = folder / FILE
    if not file.is_file():
        return []
    cells = []
    for line in file.read_text().splitlines():
        try:
            cells.append(Cell(**json.loads(line)))
        except (json.JSONDecodeError, TypeError):
            continue
    return cells


def _line(cell: Cell) -> str:
    return json.dumps(cell.plain()) + "\n"


def _computed(left: Sequence[tuple[Contender, int, str]], workers: int) -> Iterator[Cell]:
    """Cells as they are done."""
    if min(workers, len(left)) <= 1:
        yield from (compute(*order) for order in left)
        return
    with ProcessPoolExecutor(min(workers, len(left)), get_context("spawn")) as pool:
        waiting = [pool.submit(compute, *order) for order in left]
        try:
            yield from (future.result() for future in as_completed(waiting))
        finally:
            for future in waiting:
                future.cancel()
