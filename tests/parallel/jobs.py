"""Jobs for the tests: functions that other processes find."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from surface_gym.executors import Report


def draws(seed: int, report: Report) -> float:
    """Sum random numbers, and report each partial sum."""
    rng = np.random.default_rng(seed)
    total = 0.0
    for number in range(5):
        total += float(rng.standard_normal())
        report((number, total))
    return total


def own_process(report: Report) -> int:
    del report
    time.sleep(0.3)
    return os.getpid()


def counts_beginnings(folder: Path, name: str, report: Report, lasts: float = 1.0) -> int:
    """Counts its beginnings in a file, and goes on long enough to see another die."""
    with (folder / name).open("a") as file:
        file.write("begun\n")
    report("begun")
    time.sleep(lasts)
    return len((folder / name).read_text().splitlines())


def dies_at_first(folder: Path, name: str, report: Report) -> int:
    """As `counts_beginnings`, but dies in the middle of the first."""
    begun = counts_beginnings(folder, name, report, lasts=0.0)
    if begun == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return begun


def waits_for(folder: Path, name: str, sign: str, report: Report) -> int:
    """As `counts_beginnings`, but goes on until a file appears in the folder."""
    begun = counts_beginnings(folder, name, report, lasts=0.0)
    while not (folder / sign).exists():
        time.sleep(0.05)
    return begun


def always_dies(report: Report) -> None:
    del report
    os.kill(os.getpid(), signal.SIGKILL)


def fails(message: str, report: Report) -> None:
    del report
    raise ValueError(message)


class Stubborn(Exception):
    """Cannot be sent to another process."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


def fails_stubbornly(report: Report) -> None:
    del report
    raise Stubborn(1, 2)


def waits(file: Path, report: Report) -> str:
    """Goes on until it is interrupted, which it writes down and reports."""
    try:
        report("begun")
        while True:
            time.sleep(0.01)
    except KeyboardInterrupt:
        report("interrupted")
        with file.open("a") as kept:
            kept.write("interrupted\n")
        raise


def reports_for_ever(folder: Path, report: Report) -> None:
    """Goes on for ever, reporting; a file is named after its process."""
    (folder / f"{os.getpid()}.pid").touch()
    while True:
        report("here")
        time.sleep(0.05)
