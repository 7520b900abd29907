"""The report of a run: counts and durations of stages, as JSON and on screen."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from surface_gym.files import replacing

if TYPE_CHECKING:
    from rich.console import Console

MAX_NAMES = 50  # maximum number of different outcomes or faults
MAX_NAME = 200  # maximum characters of a name
FILE = "report.json"
PERCENTILES = (50.0, 90.0, 99.0, 100.0)
NAMES = ("50 %", "90 %", "99 %", "max")
STAGES = {
    "sensor": "from the latest frame to the estimate",
    "filter": "reading, estimating, observing",
    "policy": "deciding",
    "send": "until the axes began to turn",
    "turn": "until the last axis has turned, as computed",
    "whole": "from the latest frame until then",
    "late": "from when a period is due to its beginning",
    "work": "of a period, from its beginning to its end",
}


@dataclass
class Counts:
    """Numbers of events in a run."""

    periods: int = 0  # control periods begun
    kept: int = 0  # periods done before the next was due
    missed: int = 0  # periods done later
    skipped: int = 0  # periods not begun, since an earlier one took too long
    decisions: int = 0  # decisions by the policy
    by_fixed_layout: int = 0  # periods with the fixed layout instead of the policy
    held: int = 0  # periods with a parcel and unchanged axes
    unconnected: int = 0  # periods without a device
    sent: int = 0  # axis commands sent
    out_of_range: int = 0  # invalid axis commands, not sent
    refused: int = 0  # axis commands refused by the device
    strayed: int = 0  # observations out of bounds
    frames: int = 0  # frames received
    frames_unused: int = 0  # frames of another parcel, out of order, too late or too early
    unused: int = 0  # other messages of unknown parcels, or with invalid times
    watchdog: int = 0  # interruptions of frames for too long
    unacknowledged: int = 0  # interruptions of acknowledgements for too long
    set_back: int = 0  # times that the clock was set back
    connected: int = 0  # successful connections
    lost: int = 0  # losses of the device
    attempts: int = 0  # attempts to connect
    unfit: int = 0  # parcels that do not fit the surface or the task
    parcels: Counter[str] = field(default_factory=Counter)  # by outcome
    faults: Counter[str] = field(default_factory=Counter)  # faults of the device, by name


@dataclass
class Latencies:
    """Latencies [s] of the stages in `STAGES`: lists with a number for each sent decision.

    The list `work` has a number for each control period instead.
    """

    late: list[float] = field(default_factory=list)
    sensor: list[float] = field(default_factory=list)
    filter: list[float] = field(default_factory=list)
    policy: list[float] = field(default_factory=list)
    send: list[float] = field(default_factory=list)
    turn: list[float] = field(default_factory=list)
    whole: list[float] = field(default_factory=list)
    work: list[float] = field(default_factory=list)


def count_name(counts: Counter[str], name: str) -> None:
    """Make a text short and printable, and count the result.

    If `MAX_NAMES` texts are counted already, all new texts are counted together as "others".
    """
    plain = "".join(each if each.isprintable() else "?" for each in name[:MAX_NAME])
    counts[plain if plain in counts or len(counts) < MAX_NAMES else "others"] += 1


def percentiles(seconds: Sequence[float]) -> list[float] | None:
    """Return the `PERCENTILES` [s] of durations [s], or None if the list is empty."""
    if not seconds:
        return None
    return np.percentile(np.array(seconds), PERCENTILES).tolist()


def make_report(run: dict[str, Any], counts: Counts, latencies: Latencies) -> dict[str, Any]:
    """Return the report on a run as JSON data; `run` describes the run by names and values."""
    parcels = sum(counts.parcels.values())
    named = {name: dict(getattr(counts, name).most_common()) for name in ("parcels", "faults")}
    return {
        "run": run,
        "counts": {**asdict(counts), **named},
        "success": counts.parcels["success"] / parcels if parcels else None,
        "percentiles": list(NAMES),
        "budget": {name: percentiles(getattr(latencies, name)) for name in STAGES},
    }


def write_report(report: dict[str, Any], folder: Path) -> Path:
    """Write a report to a folder, and return the file."""
    file = folder / FILE
    with replacing(file) as part:
        part.write_text(json.dumps(report, indent=2) + "\n")
    return file


def show_report(report: dict[str, Any], console: "Console") -> None:
    """Print a report."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    budget = Table(
        title=f"Latency in ms, beside a period of {1e3 * report['run']['period']:g} ms",
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    budget.add_column("stage")
    for name in NAMES:
        budget.add_column(name, justify="right")
    budget.add_column("")
    for name, times in report["budget"].items():
        row = ["-"] * len(NAMES) if times is None else [f"{1e3 * each:.2f}" for each in times]
        budget.add_row(name, *row, STAGES[name])
    console.print(budget)
    for line in _lines(report):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _lines(report: dict[str, Any]) -> Iterator[str]:
    """Yield a report's lines: the run, the counts, the outcomes of parcels and the faults."""
    run, counts, success = report["run"], report["counts"], report["success"]
    load = ", ".join(f"{each:.2f}" for each in run["load"])
    yield f"{run['agent']} for {run['seconds']:.0f} s; load {load} on {run['cores']} cores"
    parcels, faults = counts["parcels"], counts["faults"]
    yield ", ".join(
        f"{name.replace('_', ' ')} {value}"
        for name, value in counts.items()
        if not isinstance(value, dict)
    )
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in parcels.items())
    yield f"{sum(parcels.values())} parcels" + (
        "" if success is None else f", success {success:.3f}: {outcomes}"
    )
    for name, count in faults.items():
        yield f"fault of the device, {count} times: {name}"
