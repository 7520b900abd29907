"""Examples run as a person would, shortly, and what they print and keep."""

import math
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

EXAMPLES = Path(__file__).parents[2] / "examples" / "learners"
PROGRESS = re.compile(r"^ *(\d+) periods: return (\S+), loss (\S+)$", re.MULTILINE)


@dataclass(frozen=True)
class Run:
    """What an example printed."""

    returns: list[float]  # as it went on
    losses: list[float]
    kept: dict[str, Any]  # in its file

    @property
    def results(self) -> dict[str, Any]:
        return self.kept["figures"]


def run(example: str, steps: int, folder: Path) -> Run:
    """Run an example for so many steps; it keeps in the folder what it prints last."""
    file = folder / "kept.yml"
    arguments = ["--steps", str(steps), "--keep", str(file)]
    command = [sys.executable, str(EXAMPLES / f"{example}.py"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=300)
    assert done.returncode == 0, done.stderr
    text = file.read_text()
    assert done.stdout.endswith(text)
    run = PROGRESS.findall(done.stdout)
    return Run(
        [float(mean) for _, mean, _ in run], [float(loss) for *_, loss in run], yaml.safe_load(text)
    )


def check_sort(run: Run, *packages: str) -> None:
    """It got better, by finite losses, and sorts more than chance does; versions are kept."""
    assert all(math.isfinite(loss) for loss in run.losses)
    assert run.returns[-1] > run.returns[0] + 1.0
    shares = run.results["0.3 to 2.7 m/s evenly"]
    assert shares["both"] > 0.4
    assert min(shares["S"], shares["B"]) <= shares["both"] <= max(shares["S"], shares["B"])
    assert set(packages) < set(run.kept["versions"])
    assert run.kept["cores"] == os.cpu_count()
