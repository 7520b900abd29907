"""Report of a line's design: a sentence, tables, a figure and JSON."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from surface_gym.design import report
from surface_gym.parallel import Workers

from .design import (
    ARRANGED,
    COLUMNS,
    FOLLOWED,
    FOUR,
    HARDWARE,
    MODULES,
    SERIES,
    SIX,
    STUCK,
    FlowCase,
    LineDesign,
    OnProgress,
    design_flow,
)

# Okabe and Ito's colours, as in the package's other plots.
COLOURS = dict(zip(HARDWARE, ("#999999", "#cc79a7", "#e69f00", "#009e73", "#0072b2"), strict=True))
STYLES = {len(FOUR): "-", len(SIX): "--"}
AT = tuple(f"{angle:g} deg" for angle in SIX)


@dataclass(frozen=True)
class FlowAnswer(report.Answer):
    """The shortest line of each hardware."""

    case: FlowCase
    rows: tuple[LineDesign, ...]

    name = "flow"

    @property
    def able(self) -> list[LineDesign]:
        return [row for row in self.rows if row.carries]

    @property
    def sentence(self) -> str:
        rate = f"{self.case.rate:g} parcels an hour"
        if not self.able:
            best = max(self.rows, key=lambda row: row.predicted, default=None)
            most = "" if best is None else f": most, {best.predicted:.0f}, does {_describe(best)}"
            return f"No line of up to {self.case.longest:g} m carries {rate}{most}"
        shortest = min(self.able, key=lambda row: (row.length, row.actuators))
        fewest = min(self.able, key=lambda row: (row.actuators, row.length))
        text = f"To carry {rate}, the shortest line is {_describe(shortest)}"
        if fewest.actuators == shortest.actuators:
            text += ", and none has fewer actuators"
        else:
            text += f"; the fewest actuators has {_describe(fewest)}"
        unable = [row for row in self.rows if not row.carries and row.actuators < fewest.actuators]
        best = max(unable, key=lambda row: row.predicted, default=None)
        more = "" if best is None else f". With fewer, {best.predicted:.0f} are carried at most"
        return text + more

    def tables(self) -> tuple[report.ReportTable, ...]:
        names, rows = zip(*self._distinct(), strict=True) if self.rows else ((), ())
        lines = [
            (row.carries, f"{row.length:.1f} m", row.actuators, round(row.predicted))
            for row in rows
        ]
        runs = [
            (
                f"{run.share_correct:.4f}", f"{run.touches_per_1000:.1f}",
                f"{run.turns_per_parcel:.1f}", round(run.turns_per_hour),
            )
            for run in (row.run for row in rows)
        ]  # fmt: skip
        measured = [(f"{row.run.rate:.0f} ±{row.run.margin:.0f}",) for row in rows]
        times = [
            (*(f"{share:.3f}" for share in shares), *("-" for _ in SIX[len(shares) :]))
            for shares in (row.run.share_at for row in rows)
        ]
        stuck = [
            (
                *name, f"{share:.0%}", round(run.rate), f"{left:.3f}", f"{run.share_correct:.4f}",
                run.jams,
            )
            for name, row in zip(names, rows, strict=True)
            for share, run, left in zip(STUCK, row.stuck, row.left, strict=False)
        ]  # fmt: skip
        curves = [
            (row.hardware, len(row.orientations), length, rate)
            for row in self.rows
            for length, rate in row.curve
        ]
        titles = (
            "The shortest line that carries it, or the best where none does; parcels an hour",
            "Measured, always a parcel at the gate; turns of all axes a parcel, of one an hour",
            "Share of the time at each orientation",
            "Capacity as modules are stuck at 90 deg, unknown to the scheduler",
        )
        who = ("hardware", "angles")
        line_header = (*who, "carries", "line", "actuators", "predicted")
        run_header = (*who, "measured", "correct", "touches/1000", "turns", "turns/h")
        stuck_header = (*who, "stuck", "correct/h", "of all", "correct", "jams")

        def table(k: int, name: str, header: tuple[str, ...], *parts: Any) -> report.ReportTable:
            cells = tuple(sum(each, ()) for each in zip(*parts, strict=True))
            return report.ReportTable(name, titles[k], header, cells)

        return (
            table(0, "flow", line_header, names, lines),
            table(1, "flow-runs", run_header, names, measured, runs),
            table(2, "flow-time", (*who, *AT), names, times),
            table(3, "flow-stuck", stuck_header, stuck),
            report.ReportTable(
                "flow-curves", "", (*who, "line [m]", "predicted [1/h]"), tuple(curves),
                shown=False,
            ),
        )  # fmt: skip

    def _distinct(self) -> list[tuple[tuple[str, str], LineDesign]]:
        """List distinct lines, without repeats that differ by unused orientations only."""
        found: list[tuple[tuple[str, str], LineDesign]] = []
        for row in self.rows:
            few = found[-1][1] if found else None
            if few is not None and (few.hardware, few.length, few.predicted) == (
                row.hardware, row.length, row.predicted,
            ):  # fmt: skip
                stuck = few.stuck or row.stuck
                found[-1] = (
                    (row.hardware, f"{found[-1][0][1]}, {len(row.orientations)}"),
                    replace(few, stuck=stuck),
                )
            else:
                found.append(((row.hardware, str(len(row.orientations))), row))
        return found

    def draw(self) -> "report.Figure":
        """Draw the rate over the length, and the remaining rate over the share of failures."""
        figure = report.new_figure(
            9.6, 4.8, f"Which line carries {self.case.rate:g} parcels an hour?", "medium"
        )
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        four = {row.hardware: row.curve for row in self.rows if row.orientations == FOUR}
        for row in self.rows:
            colour = COLOURS[row.hardware]
            if row.orientations == FOUR or row.curve != four.get(row.hardware):
                label = f"{row.hardware}{'' if row.orientations == FOUR else ', and ±80 deg'}"
                style = STYLES[len(row.orientations)]
                left.plot(*np.transpose(row.curve), color=colour, linestyle=style, label=label)
            if row.carries:
                left.plot(row.length, row.predicted, "o", color=colour, markersize=6)
            if row.stuck:
                right.plot(100.0 * np.array(STUCK), row.left, "o-", color=colour)
        left.axhline(self.case.rate, color="black", linewidth=0.8, linestyle=":", label="asked for")
        left.set(xlabel="line [m]", ylabel="parcels an hour, predicted", xlim=(0.0, None))
        left.set_ylim(0.0, None)
        right.set(xlabel="modules stuck [%]", ylabel="of the capacity", ylim=(0.0, 1.05))
        for panel in (left, right):
            panel.grid(alpha=0.25)
            panel.spines[["top", "right"]].set_visible(False)
        figure.legend(
            *left.get_legend_handles_labels(), loc="outside lower center", ncols=3,
            fontsize="small", frameon=False,
        )  # fmt: skip
        return figure

    def as_json(self) -> dict[str, Any]:
        """Return the answer as JSON data."""
        case = {"rate": self.case.rate, "speed": self.case.speed, "longest": self.case.longest}
        return {**case, "stuck_shares": STUCK, "lines": [asdict(row) for row in self.rows]}


def _describe(row: LineDesign) -> str:
    words = {
        ARRANGED: "one zone that is arranged anew for each parcel",
        FOLLOWED: "one zone that parcels for the same exit may follow each other over",
        SERIES: "zones in series",
        COLUMNS: "one actuator a column",
        MODULES: "every module by itself",
    }[row.hardware]
    return (
        f"{row.length:.1f} m, {words} ({report.plural(row.actuators, 'actuator')}, "
        f"{len(row.orientations)} orientations)"
    )


def answer_flow(case: FlowCase, workers: Workers, on_progress: OnProgress) -> FlowAnswer:
    """Find the shortest line of each hardware."""
    return FlowAnswer(case, design_flow(case, workers, on_progress))
