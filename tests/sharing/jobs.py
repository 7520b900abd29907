"""Jobs for the tests: functions that other processes find."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from surface_gym.parallel import Report


def draws(seed: int, tell: Report) -> float:
    """A sum of what is drawn, told number by number."""
    rng = np.random.default_rng(seed)
    total = 0.0
    for number in range(5):
        total += float(rng.standard_normal())
        tell((number, total))
    return total


def own_process(tell: Report) -> int:
    del tell
    time.sleep(0.3)
    return os.getpid()


def dies_at_first(folder: Path, name: str, tell: Report) -> int:
    """Counts its beginnings in a file, and dies in the middle of the first."""
    with (folder / name).open("a") as file:
        file.write("begun\n")
    tell("begun")
    begun = len((folder / name).read_text().splitlines())
    if begun == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return begun


def always_dies(tell: Report) -> None:
    del tell
    os.kill(os.getpid(), signal.SIGKILL)


def fails(message: str, tell: Report) -> None:
    del tell
    raise ValueError(message)


class Stubborn(Exception):
    """Cannot be sent to another process."""

    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


def fails_stubbornly(tell: Report) -> None:
    del tell
    raise Stubborn(1, 2)


def waits(file: Path, tell: Report) -> str:
    """Goes on until it is interrupted, which it writes down and tells."""
    try:
        tell("begun")
        while True:
            time.sleep(0.01)
    except KeyboardInterrupt:
        tell("interrupted")
        with file.open("a") as kept:
            kept.write("interrupted\n")
        raise


def counts_beginnings(folder: Path, name: str, tell: Report) -> int:
    """As `dies_at_first`, without dying, and long enough to see another die."""
    with (folder / name).open("a") as file:
        file.write("begun\n")
    tell("begun")
    time.sleep(1.0)
    return len((folder / name).read_text().splitlines())


def tells_its_process(folder: Path, tell: Report) -> None:
    """Goes on for ever, telling; a file is named after its process."""
    (folder / f"{os.getpid()}.pid").touch()
    while True:
        tell("here")
        time.sleep(0.05)


def waits_for(folder: Path, name: str, sign: str, tell: Report) -> int:
    """Counts its beginnings in a file, and goes on until there is a sign in the folder."""
    with (folder / name).open("a") as file:
        file.write("begun\n")
    tell("begun")
    while not (folder / sign).exists():
        time.sleep(0.05)
    return len((folder / name).read_text().splitlines())
