"""The cells of a comparison; what is computed is kept."""

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from surface_gym.conditions import CONDITIONS
from surface_gym.sharing import Workers, quiet, share

from .cell import Cell, compute
from .contenders import Contender

FILE = "cells.jsonl"

Key = tuple[Any, ...]
Advance = Callable[[int, int, str], None]


class Kept(Protocol):
    """What a comparison computes and keeps in a file."""

    @property
    def key(self) -> Key:
        """What it is of; the first three say so to a reader."""

    def plain(self) -> dict[str, Any]:
        """As JSON takes it."""


AnyKept = TypeVar("AnyKept", bound=Kept)
AnyKey = TypeVar("AnyKey", bound=Key)


def orders(contenders: Sequence[Contender]) -> list[tuple[Contender, int, str]]:
    """Every contender, seed and condition to compute; the slowest first, to fill the cores."""
    found = [
        (contender, seed, condition.name)
        for contender in contenders
        for seed in contender.seeds
        for condition in CONDITIONS.values()
        if contender.conditions is None or condition.name in contender.conditions
    ]
    return sorted(found, key=lambda order: order[0].starts is None)


def compute_kept(
    jobs: Mapping[AnyKey, Callable[[], AnyKept]],
    make: Callable[..., AnyKept],
    workers: Workers,
    file: Path | None,
    advance: Advance,
) -> dict[AnyKey, AnyKept]:
    """Compute what is not kept yet.

    Args:
        jobs: to do, by the key of what each gives, which do not depend on each other.
        make: one from what its `plain` gave.
        workers: processes to share the work among, or a cluster.
        file: where they are kept, a line each; those found there are not computed again.
        advance: called with how many are done, how many there are and the name of the latest.

    Returns:
        All of them by key, in the order of the jobs.
    """
    found: dict[Key, AnyKept] = {}
    if file is not None:
        found = {each.key: each for each in read_kept(file, make)}
        # A line that was broken off must not spoil the next.
        file.write_text("".join(map(_line, found.values())))
    left = [partial(quiet, job) for key, job in jobs.items() if key not in found]
    for done, (_, each) in enumerate(share(left, workers), len(jobs) - len(left) + 1):
        found[each.key] = each
        if file is not None:
            with file.open("a") as kept:
                kept.write(_line(each))
        advance(done, len(jobs), ", ".join(map(str, each.key[:3])))
    return {key: found[key] for key in jobs}


def compute_cells(
    contenders: Sequence[Contender],
    workers: Workers,
    folder: Path | None = None,
    advance: Advance = lambda *_: None,
) -> list[Cell]:
    """Compute the cells of all contenders, in an order that does not depend on the processes.

    Args:
        contenders: to compare.
        workers: processes to share the work among, or a cluster.
        folder: cells are kept in its cells.jsonl, and those found there are not computed again.
        advance: called with cells done, cells in all and the name of the latest.
    """
    jobs = {
        (who.task, who.name, condition, seed): partial(compute, who, seed, condition)
        for who, seed, condition in orders(contenders)
    }
    file = None if folder is None else folder / FILE
    found = compute_kept(jobs, Cell, workers, file, advance)
    order = {(who.task, who.name): k for k, who in enumerate(contenders)}
    places = {condition.name: k for k, condition in enumerate(CONDITIONS.values())}
    return sorted(
        found.values(),
        key=lambda cell: (order[cell.key[:2]], places[cell.condition], cell.seed),
    )


def read_cells(folder: Path) -> list[Cell]:
    """The cells kept in a folder."""
    return read_kept(folder / FILE, Cell)


def read_kept(file: Path, make: Callable[..., AnyKept]) -> list[AnyKept]:
    """What is kept in a file, a last line left out that was broken off; nothing where there is no
    file.
    """
    if not file.is_file():
        return []
    found = []
    for line in file.read_text().splitlines():
        try:
            found.append(make(**json.loads(line)))
        except (json.JSONDecodeError, TypeError, KeyError):
            continue
    return found


def _line(each: Kept) -> str:
    return json.dumps(each.plain()) + "\n"
