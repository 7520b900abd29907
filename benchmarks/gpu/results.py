"""What was measured on a GPU, as figures, a table and data."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rich.table import Table

from benchmarks.environments import TASKS
from benchmarks.figure import Figure, written
from benchmarks.gpu.agreement import CLOSE, Agreement
from benchmarks.gpu.resets import Resets
from benchmarks.gpu.windows import Rate

# What the project asks of itself, of a data-centre card and the S-box alone.
SMALL = "Sort, S-box alone"
LEAST_DECISIONS = 40e6  # [1/s]
LEAST_OVER_CORE = 150.0
MOST_OFF = 0.001  # share of the lanes that may end elsewhere, or otherwise


def on_gpu(task: str) -> str:
    """A task's lanes on the GPU, by name."""
    return f"{task}, GPU"


def on_cpu(task: str, threads: int) -> str:
    """A task's lanes on the CPU, by name."""
    return f"{task}, CPU, " + ("one core" if threads == 1 else f"{threads} threads")


@dataclass
class Results:
    """What was measured so far."""

    machine: str  # GPU, CPU and what drives them
    rates: list[Rate] = field(default_factory=list)
    resets: list[Resets] = field(default_factory=list)
    agreement: list[Agreement] = field(default_factory=list)  # one, where it was measured
    left_out: list[str] = field(default_factory=list)  # of other packages: what, and why
    failed: list[str] = field(default_factory=list)  # of our own: what, and why

    def over_core(self, rate: Rate) -> float | None:
        """A rate of our lanes over one core's in the same task; None for another's."""
        for task in TASKS:
            cores = [each for each in self.rates if each.name == on_cpu(task, 1)]
            if cores and rate.name.startswith((f"{task}, GPU", f"{task}, CPU")):
                return rate.decisions / cores[0].decisions
        return None

    def figures(self) -> list[Figure]:
        """The figures that something is asked of."""
        figures = []
        for task in TASKS:
            rates = [rate for rate in self.rates if rate.name == on_gpu(task)]
            if not rates:
                continue
            best, asked = max(rates, key=lambda rate: rate.decisions), task == SMALL
            name = f"{task}, {best.lanes:,} lanes, halves, resets included"
            figures.append(
                Figure(name, best.decisions, "1/s", least=LEAST_DECISIONS if asked else None)
            )
            ratio = self.over_core(best)
            if ratio is not None:
                least = LEAST_OVER_CORE if asked else None
                figures.append(Figure(f"{task}, over one core", ratio, "", least=least))
        for agreement in self.agreement:
            of, most = f"lanes of {agreement.lanes:,}", MOST_OFF * agreement.lanes
            figures += [
                Figure(f"{of} that end {CLOSE:g} m and more from the CPU's", agreement.apart, "",
                       most=most),
                Figure(f"{of} with another outcome", agreement.other_outcomes, "", most=most),
                Figure(f"{of} whose episodes last longer or shorter", agreement.other_lengths, ""),
                Figure("median distance between the ends", agreement.median, "m"),
                Figure("largest, where outcomes are equal", agreement.largest, "m"),
            ]  # fmt: skip
        return figures

    def write(self, file: Path) -> None:
        """Write all as JSON."""
        data = {**asdict(self), "figures": [asdict(figure) for figure in self.figures()]}
        file.write_text(json.dumps(data, indent=1) + "\n")

    def table(self) -> Table:
        """Rates, beside what resets cost."""
        table = Table("lanes of", title=self.machine)
        columns = (
            "lanes", "decisions/s", "over one core", "episodes/s", "in resets",
            "starts laid out/s", "reset of all", "first reset",
        )  # fmt: skip
        for column in columns:
            table.add_column(column, justify="right")
        for rate in self.rates:
            ratio = self.over_core(rate)
            table.add_row(
                rate.name,
                f"{rate.lanes:,}",
                written(rate.decisions),
                "" if ratio is None else f"{written(ratio)} x",
                written(rate.episodes) if rate.episodes else "",
                *_reset_cells(rate, self.resets),
                f"{rate.first:.3g} s",
            )
        return table


def _reset_cells(rate: Rate, resets: Sequence[Resets]) -> tuple[str, str, str]:
    for each in resets:
        if (each.name, each.lanes) == (rate.name, rate.lanes):
            return f"{100.0 * each.share:.3g} %", written(each.laid_out), f"{each.reset:.3g} s"
    return "", "", ""
