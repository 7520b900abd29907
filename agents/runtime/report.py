"""What came of a run: counts and a budget of time, as JSON and on screen."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from surface_gym.whole_files import replacing

from .counting import Counts, Latencies

FILE = "report.json"
PERCENTILES = (50.0, 90.0, 99.0, 100.0)
NAMES = ("50 %", "90 %", "99 %", "max")
STAGES = {
    "sensor": "from the latest frame to the estimate",
    "filter": "reading, estimating, observing",
    "policy": "deciding",
    "send": "until the device took the axes",
    "turn": "until the last axis has turned, as reckoned",
    "whole": "from the latest frame until then",
    "late": "from when a period is due to its beginning",
    "work": "of a period, from its beginning to its end",
}


@dataclass(frozen=True)
class Run:
    """What was run."""

    agent: str
    seed: int  # of the policy
    task: str
    condition: str
    device: str  # the simulator, or an address
    period: float  # [s]
    watchdog: float  # [s]
    seconds: float  # [s] that it ran
    load: tuple[float, float, float]  # of the machine at the end, over 1, 5 and 15 minutes
    cores: int  # of the machine


def budget_of(latencies: Latencies) -> dict[str, list[float] | None]:
    """[s] the percentiles of each stage; None: it was never measured."""
    return {name: percentiles(getattr(latencies, name)) for name in STAGES}


def percentiles(seconds: Sequence[float]) -> list[float] | None:
    """[s] `PERCENTILES` of some times; None: there are none."""
    if not seconds:
        return None
    found: list[float] = np.percentile(np.array(seconds), PERCENTILES).tolist()
    return found


def report_of(run: Run, counts: Counts, latencies: Latencies) -> dict[str, Any]:
    """All of it, as it is written."""
    parcels = sum(counts.parcels.values())
    return {
        "run": asdict(run),
        "counts": {**asdict(counts), "parcels": dict(counts.parcels.most_common())},
        "success": counts.parcels["success"] / parcels if parcels else None,
        "percentiles": list(NAMES),
        "budget": budget_of(latencies),
    }


def write_report(report: dict[str, Any], folder: Path) -> Path:
    """Write a report into a folder; the file."""
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
        told = ["-"] * len(NAMES) if times is None else [f"{1e3 * each:.2f}" for each in times]
        budget.add_row(name, *told, STAGES[name])
    console.print(budget)
    for line in sentences(run, counts, report["success"]):
        console.print(line, highlight=False, soft_wrap=True)


def sentences(run: dict[str, Any], counts: dict[str, Any], success: float | None) -> list[str]:
    """What was counted, in words."""
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
        f"{counts['frames']} frames, {counts['frames_unused']} of no use; device killed "
        f"{counts['kills']} times, lost {counts['lost']} times, found {counts['connected']} times "
        f"in {counts['attempts']} attempts, away in {counts['unconnected']} periods",
        f"{sum(counts['parcels'].values())} parcels"
        + ("" if success is None else f", success {success:.3f}: {parcels}")
        + (f"; {counts['unfit']} that do not fit" if counts["unfit"] else ""),
    ]
