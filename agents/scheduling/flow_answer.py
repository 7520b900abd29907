"""The answer to which line carries a rate: a sentence, tables and a plot of all hardware."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from surface_gym.design.case import Answer, ReportTable, new_figure, plural
from surface_gym.design.loads import wear_tables
from surface_gym.flow.arrivals import HOUR
from surface_gym.parallel import Workers, map_jobs, without_report

from .design import (
    ARRANGED,
    COLUMNS,
    FOLLOWED,
    FOUR,
    HARDWARE,
    MODULES,
    ROTOR_ROWS,
    SERIES,
    SIX,
    STUCK,
    FlowCase,
    LineDesign,
    find_lines,
)
from .driven import STREAM_KINDS

# Okabe and Ito's colours, as in the package's other plots.
COLOURS = dict(zip(HARDWARE, ("#999999", "#cc79a7", "#e69f00", "#009e73", "#0072b2"), strict=True))
STYLES = {len(FOUR): "-", len(SIX): "--"}
AT = tuple(f"{angle:g} deg" for angle in SIX)

OnProgress = Callable[[int, int], None]


@dataclass(frozen=True)
class FlowAnswer(Answer):
    """Answer with the shortest line that carries the rate, for each kind of hardware."""

    case: FlowCase
    rows: tuple[LineDesign, ...]
    driven: tuple[LineDesign, ...] = ()  # of driven modules, with one set of motors a column

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
            text += f"; the line with the fewest actuators is {_describe(fewest)}"
        unable = [row for row in self.rows if not row.carries and row.actuators < fewest.actuators]
        best = max(unable, key=lambda row: row.predicted, default=None)
        more = "" if best is None else f". Fewer actuators carry at most {best.predicted:.0f}"
        return text + more + self._saving(fewest)

    def _saving(self, idle: LineDesign) -> str:
        """Describe what an idle line saves compared with the driven line with the fewest motors."""
        able = [row for row in self.driven if row.carries]
        if not able:
            return ""
        each = self.case.turn_energy
        row = min(able, key=lambda row: (row.motor_count, row.energy(each)))
        saved = row.energy(each) - idle.energy(each)
        return (
            f". Of driven modules, {row.hardware} need the fewest motors: {row.motor_count} on "
            f"{row.length:.1f} m. The idle line saves {row.motor_count - idle.motor_count} motors "
            f"and {saved:.1f} J a parcel, which is {saved * self.case.rate / HOUR:.1f} W"
        )

    def tables(self) -> tuple[ReportTable, ...]:
        lines, runs, times, stuck = (list[tuple[Any, ...]]() for _ in range(4))
        for name, row in self._distinct():
            run = row.run
            lines.append(
                (*name, row.carries, f"{row.length:.1f} m", row.actuators, round(row.predicted))
            )
            runs.append(
                (
                    *name, f"{run.rate:.0f} ±{run.margin:.0f}", f"{run.share_correct:.4f}",
                    f"{run.touches_per_1000:.1f}", f"{run.turns_per_parcel:.1f}",
                    round(run.turns_per_hour),
                )
            )  # fmt: skip
            shares = [f"{share:.3f}" for share in run.share_at]
            times.append((*name, *shares, *["-"] * (len(SIX) - len(shares))))
            stuck += [
                (
                    *name, f"{share:.0%}", round(failing.rate), f"{remaining:.3f}",
                    f"{failing.share_correct:.4f}", failing.jams,
                )
                for share, failing, remaining in zip(
                    STUCK, row.stuck, row.remaining, strict=False
                )
            ]  # fmt: skip
        curves = [
            (row.hardware, len(row.orientations), length, rate)
            for row in self.rows
            for length, rate in row.curve
        ]
        who = ("hardware", "angles")
        return (
            ReportTable(
                "flow",
                "The shortest line that carries it, or the best where none does; parcels an hour",
                (*who, "carries", "line", "actuators", "predicted"),
                tuple(lines),
            ),
            ReportTable(
                "flow-runs",
                "Measured, always a parcel at the gate; turns of all axes a parcel, of one an hour",
                (*who, "measured", "correct", "touches/1000", "turns", "turns/h"),
                tuple(runs),
            ),
            ReportTable(
                "flow-time", "Share of the time at each orientation", (*who, *AT), tuple(times)
            ),
            ReportTable(
                "flow-stuck",
                "Capacity as modules are stuck at 90 deg, unknown to the scheduler",
                (*who, "stuck", "correct/h", "of all", "correct", "jams"),
                tuple(stuck),
            ),
            *wear_tables(
                self.case.turn_energy,
                self.case.turn_life,
                [
                    (name, each.run.turns_per_parcel / (ROTOR_ROWS * each.zone or 1), each.run)
                    for name, each in self._distinct()
                ],
            ),
            *self._driven_tables(),
            ReportTable(
                "flow-curves", "", (*who, "line [m]", "predicted [1/h]"), tuple(curves), shown=False
            ),
        )

    def _driven_tables(self) -> tuple[ReportTable, ...]:
        """Return the table of idle and driven lines; without driven lines, return no table."""
        if not self.driven:
            return ()
        each = self.case.turn_energy
        rows = tuple(
            (
                row.hardware, row.carries, f"{row.length:.1f} m", row.motor_count,
                f"{row.run.rate:.0f} ±{row.run.margin:.0f}", f"{row.energy(each):.1f}",
                f"{row.energy(each) * self.case.rate / HOUR:.1f}",
            )
            for row in (*(line for _, line in self._distinct()), *self.driven)
        )  # fmt: skip
        return (
            ReportTable(
                "flow-driven",
                "Idle rotors beside driven modules with one set of motors a column; axes that turn "
                f"take {each:g} J",
                ("modules", "carries", "line", "motors", "measured", "J/parcel", "W"),
                rows,
            ),
        )

    def _distinct(self) -> list[tuple[tuple[str, str], LineDesign]]:
        """List pairs ((hardware, text), line). The text "4, 6" means 4 or 6 orientations."""
        found: list[tuple[tuple[str, str], LineDesign]] = []
        for row in self.rows:
            own = (row.hardware, row.length, row.predicted)
            (_, angles), few = found[-1] if found else (("", ""), None)
            if few is not None and (few.hardware, few.length, few.predicted) == own:
                same = replace(few, stuck=few.stuck or row.stuck)
                found[-1] = ((row.hardware, f"{angles}, {len(row.orientations)}"), same)
            else:
                found.append(((row.hardware, str(len(row.orientations))), row))
        return found

    def draw(self) -> Any:
        """Plot rates over lengths of lines, and relative rates over shares of stuck modules."""
        figure = new_figure(
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
                right.plot(100.0 * np.array(STUCK), row.remaining, "o-", color=colour)
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
        case = {"rate": self.case.rate, "speed": self.case.speed, "longest": self.case.longest}
        return {
            **case,
            "stuck_shares": STUCK,
            "lines": [asdict(row) for row in (*self.rows, *self.driven)],
        }


def _describe(row: LineDesign) -> str:
    words = {
        ARRANGED: "one zone that is arranged anew for each parcel",
        FOLLOWED: "one zone that parcels for the same exit may follow each other over",
        SERIES: "zones in series",
        COLUMNS: "one actuator a column",
        MODULES: "every module by itself",
    }[row.hardware]
    return (
        f"{row.length:.1f} m, {words} ({plural(row.actuators, 'actuator')}, "
        f"{len(row.orientations)} orientations)"
    )


def answer_flow(
    case: FlowCase, workers: Workers = 1, on_progress: OnProgress = lambda *_: None
) -> FlowAnswer:
    """Find the shortest lines for each entry of `HARDWARE`. If `case.driven`, add driven modules.

    `on_progress` gets the number of finished searches, and the number of all searches. For
    `workers` see `map_jobs`.
    """
    kinds = tuple(STREAM_KINDS) if case.driven else ()
    order = (MODULES, *kinds, COLUMNS, SERIES, FOLLOWED, ARRANGED)  # the slowest first
    jobs = [partial(without_report, partial(find_lines, case, hardware)) for hardware in order]
    found: dict[str, tuple[LineDesign, ...]] = {}
    for index, rows in map_jobs(jobs, workers):
        found[order[index]] = rows
        on_progress(len(found), len(order))
    rows, driven = (
        tuple(row for each in names for row in found[each]) for names in (HARDWARE, kinds)
    )
    return FlowAnswer(case, rows, driven)
