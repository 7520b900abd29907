"""The report of a run: counts and latencies, as JSON and on screen."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from surface_gym.files import replacing

from .controller import Counts, Latencies

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


@dataclass(frozen=True)
class Run:
    """The circumstances of a run."""

    agent: str
    seed: int  # of the policy
    task: str
    preset: str  # of the machine
    device: str  # the simulator, or an address
    period: float  # [s]
    watchdog: float  # [s]
    seconds: float  # [s] that it ran
    load: tuple[float, float, float]  # of the machine at the end, over 1, 5 and 15 minutes
    cores: int  # of the machine


def latency_percentiles(latencies: Latencies) -> dict[str, list[float] | None]:
    """Return the percentiles [s] of each stage; None: it was never measured."""
    return {name: percentiles(getattr(latencies, name)) for name in STAGES}


def percentiles(seconds: Sequence[float]) -> list[float] | None:
    """Compute `PERCENTILES` [s] of some times; None: there are none."""
    if not seconds:
        return None
    found: list[float] = np.percentile(np.array(seconds), PERCENTILES).tolist()
    return found


def make_report(run: Run, counts: Counts, latencies: Latencies) -> dict[str, Any]:
    """Return the report as it is written."""
    parcels = sum(counts.parcels.values())
    return {
        "run": asdict(run),
        "counts": {**asdict(counts), "parcels": dict(counts.parcels.most_common())},
        "success": counts.parcels["success"] / parcels if parcels else None,
        "percentiles": list(NAMES),
        "budget": latency_percentiles(latencies),
    }


def write_report(report: dict[str, Any], folder: Path) -> Path:
    """Write a report into a folder, and return the file."""
    file = folder / FILE
    with replacing(file) as part:
        part.write_text(json.dumps(report, indent=2) + "\n")
    return file


def show_report(report: dict[str, Any], console: Console) -> None:
    """Print a report."""
    run, counts = report["run"], report["counts"]
    budget = Table(
        title=f"Latency in ms, beside a period of {1e3 * run['period']:g} ms",
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
    for line in _sentences(run, counts, report["success"]):
        console.print(line, highlight=False, soft_wrap=True)


def _sentences(run: dict[str, Any], counts: dict[str, Any], success: float | None) -> list[str]:
    parcels = ", ".join(f"{count} {outcome}" for outcome, count in counts["parcels"].items())
    load = ", ".join(f"{each:.2f}" for each in run["load"])
    return [
        f"{run['agent']} for {run['seconds']:.0f} s: {counts['periods']} periods, "
        f"{counts['kept']} deadlines kept, {counts['missed']} missed, {counts['skipped']} periods "
        f"skipped; load {load} on {run['cores']} cores",
        f"{counts['decisions']} decisions by the policy; fixed layout in "
        f"{counts['by_fixed_layout']} periods, frames stopped for more than "
        f"{1e3 * run['watchdog']:g} ms {counts['watchdog']} times; axes held in {counts['held']}",
        f"{counts['sent']} axis commands sent, {counts['out_of_range']} out of range and not sent, "
        f"{counts['refused']} refused by the device; {counts['strayed']} observations out of "
        "bounds",
        f"{counts['frames']} frames, {counts['frames_unused']} of no use; device lost "
        f"{counts['lost']} times, found {counts['connected']} times in {counts['attempts']} "
        f"attempts, away in {counts['unconnected']} periods",
        f"{sum(counts['parcels'].values())} parcels"
        + ("" if success is None else f", success {success:.3f}: {parcels}")
        + (f"; {counts['unfit']} that do not fit" if counts["unfit"] else ""),
    ]
