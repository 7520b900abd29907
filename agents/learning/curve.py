"""A run's learning curve: curve.csv and TensorBoard."""

import csv
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from torch.utils.tensorboard import SummaryWriter

FILE = "curve.csv"
REWARD = "reward_"  # before the name of a reward term, which may be "success" as well
RECENT_EPISODES = 1000


class Curve:
    """Means over the latest episodes: success, return, length and each reward term.

    Args:
        folder: of the run.
        terms: names of the reward terms.
        steps: done before; what the files hold beyond is dropped.
        recent: the latest episodes before.
    """

    def __init__(
        self, folder: Path, terms: tuple[str, ...], steps: int, recent: list[dict[str, float]]
    ) -> None:
        self._file = folder / FILE
        self._columns = ("steps", "success", "return", "length", *(REWARD + term for term in terms))
        self.recent: deque[dict[str, float]] = deque(recent, maxlen=RECENT_EPISODES)
        self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=steps or None)
        kept = [row for row in read_curve(folder) if row["steps"] <= steps] if steps else []
        with self._file.open("w", newline="") as file:
            table = csv.DictWriter(file, self._columns)
            table.writeheader()
            table.writerows({name: _text(row[name]) for name in self._columns} for row in kept)

    def take(self, infos: list[dict[str, Any]]) -> None:
        """Take the episodes that ended in a step of the lanes."""
        for info in infos:
            if info:
                self.recent.append(
                    {
                        "success": float(info["is_success"]),
                        "return": info["episode"]["r"],
                        "length": float(info["episode"]["l"]),
                        **{REWARD + term: paid for term, paid in info["reward_terms"].items()},
                    }
                )

    @property
    def success(self) -> float:
        """[-] of the latest episodes; nan before the first."""
        return self._mean("success")

    def write(self, steps: int) -> None:
        """Add a row."""
        row = {name: self._mean(name) for name in self._columns[1:]}
        with self._file.open("a", newline="") as file:
            csv.DictWriter(file, self._columns).writerow(
                {"steps": _text(steps), **{name: _text(value) for name, value in row.items()}}
            )
        for name, value in row.items():
            term = name.removeprefix(REWARD)
            group = "rollout" if term == name else "reward_terms"
            self._writer.add_scalar(f"{group}/{term}", value, steps)

    def close(self) -> None:
        """Flush what TensorBoard reads."""
        self._writer.close()

    def _mean(self, name: str) -> float:
        values = [episode[name] for episode in self.recent]
        return float(np.mean(values)) if values else float("nan")


def read_curve(folder: Path) -> list[dict[str, float]]:
    """The rows of a run's curve, its last line left out if it was broken off."""
    file = folder / FILE
    if not file.is_file():
        return []
    with file.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    return [
        {name: float(value) for name, value in row.items()}
        for row in rows
        if None not in row.values() and "" not in row.values()
    ]


def _text(value: float) -> str:
    return f"{value:.8g}"
