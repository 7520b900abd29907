"""Results of the benchmark on a GPU, as figures, a table, a plot and JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rich.table import Table

from benchmarks.environments import TASKS
from benchmarks.figure import Figure, format_number
from benchmarks.gpu.agreement import CLOSE, Agreement
from benchmarks.gpu.timing import Rate, ResetCost

# Requirements for a data-centre GPU and only the S-box.
SMALL = "Sort, S-box alone"
LEAST_DECISIONS = 40e6  # [1/s]
LEAST_OVER_CORE = 150.0
MOST_APART = 0.001  # share of the environments that may end elsewhere, or otherwise
DPI = 150  # of the plot


def gpu_name(task: str) -> str:
    """Return the name of a task's environments on the GPU."""
    return f"{task}, GPU"


def cpu_name(task: str, threads: int) -> str:
    """Return the name of a task's environments on the CPU."""
    return f"{task}, CPU, " + ("one core" if threads == 1 else f"{threads} threads")


@dataclass
class Results:
    """Results of all finished measurements."""

    machine: str  # GPU, CPU and their software
    rates: list[Rate] = field(default_factory=list)
    resets: list[ResetCost] = field(default_factory=list)
    agreement: list[Agreement] = field(default_factory=list)  # at most one
    left_out: list[str] = field(default_factory=list)  # other packages, with the reason
    failed: list[str] = field(default_factory=list)  # our own measurements, with the reason

    def over_core(self, rate: Rate) -> float | None:
        """Return a rate divided by one core's in the same task; None for other packages."""
        for task in TASKS:
            cores = [each for each in self.rates if each.name == cpu_name(task, 1)]
            if cores and rate.name.startswith((f"{task}, GPU", f"{task}, CPU")):
                return rate.decisions / cores[0].decisions
        return None

    def figures(self) -> list[Figure]:
        """Return the figures that have requirements."""
        figures = []
        for task in TASKS:
            rates = [rate for rate in self.rates if rate.name == gpu_name(task)]
            if not rates:
                continue
            best, required = max(rates, key=lambda rate: rate.decisions), task == SMALL
            name = f"{task}, {best.num_envs:,} environments, halves, resets included"
            figures.append(
                Figure(name, best.decisions, "1/s", least=LEAST_DECISIONS if required else None)
            )
            ratio = self.over_core(best)
            if ratio is not None:
                least = LEAST_OVER_CORE if required else None
                figures.append(Figure(f"{task}, over one core", ratio, "", least=least))
        for agreement in self.agreement:
            of, most = f"environments of {agreement.num_envs:,}", MOST_APART * agreement.num_envs
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
        """Write all results as JSON."""
        data = {**asdict(self), "figures": [asdict(figure) for figure in self.figures()]}
        file.write_text(json.dumps(data, indent=1) + "\n")

    def table(self) -> Table:
        """Make a table of the rates and the cost of resets."""
        table = Table("program", title=self.machine)
        columns = (
            "environments", "decisions/s", "over one core", "episodes/s", "in resets",
            "starts laid out/s", "reset of all", "first reset",
        )  # fmt: skip
        for column in columns:
            table.add_column(column, justify="right")
        for rate in self.rates:
            ratio = self.over_core(rate)
            table.add_row(
                rate.name,
                f"{rate.num_envs:,}",
                format_number(rate.decisions),
                "" if ratio is None else f"{format_number(ratio)} x",
                format_number(rate.episodes) if rate.episodes else "",
                *_reset_cells(rate, self.resets),
                f"{rate.first:.3g} s",
            )
        return table


def _reset_cells(rate: Rate, resets: Sequence[ResetCost]) -> tuple[str, str, str]:
    """Return the table's cells about resets for a rate; empty without a measurement of resets."""
    for each in resets:
        if (each.name, each.num_envs) == (rate.name, rate.num_envs):
            starts = format_number(each.starts)
            return f"{100.0 * each.share:.3g} %", starts, f"{each.reset:.3g} s"
    return "", "", ""


def plot_rates(rates: Sequence[Rate], file: Path) -> None:
    """Plot decisions per second against the number of environments.

    A program that was measured once, such as the CPU's, is a dashed horizontal line.
    """
    from matplotlib.figure import Figure as Plot

    from surface_gym.agents.evaluation.pictures import choose_colours

    names = list(dict.fromkeys(rate.name for rate in rates))
    plot = Plot(figsize=(9.0, 4.4), layout="constrained")
    axes = plot.subplots()
    for name, colour in choose_colours(names).items():
        points = sorted((rate.num_envs, rate.decisions) for rate in rates if rate.name == name)
        if len(points) == 1:
            axes.axhline(points[0][1], color=colour, linestyle="--", linewidth=1.0, label=name)
        else:
            axes.plot(*zip(*points, strict=True), "o-", color=colour, label=name)
    axes.set(xscale="log", yscale="log", xlabel="environments", ylabel="decisions a second")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(which="major", color="#dddddd", linewidth=0.6)
    plot.legend(loc="outside right center", frameon=False)
    plot.savefig(file, dpi=DPI)
