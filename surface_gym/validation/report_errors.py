"""Section 6.2's errors, MuJoCo in the place of Adams and beside it, on a terminal."""

from collections.abc import Iterable

import numpy as np
from rich.table import Table

from surface_gym.validation.adams import printed
from surface_gym.validation.cases import PUSHED, Run, displacement
from surface_gym.validation.comparison import Errors, Summary, errors, paper_errors
from surface_gym.validation.framing import new_table, numbers
from surface_gym.validation.study import Study


def table7(summaries: Iterable[Summary], runs: int) -> Table:
    """Mean and standard deviation over the tilts."""
    table = new_table(
        f"Table 7: errors over {runs} tilts, Eq. (5)",
        "",
        "",
        "x\n[%]",
        "y\n[%]",
        "theta\n[%]",
        "x\n[mm]",
        "y\n[mm]",
        "theta\n[deg]",
        labels=2,
    )
    for summary in summaries:
        for k, row in enumerate(("mean", "SD")):
            table.add_row(
                "" if k else summary.title,
                row,
                *numbers(summary.percent[k]),
                *numbers(summary.absolute[k]),
                end_section=k == 1,
            )
    return table


def single_runs(study: Study) -> Table:
    """The two runs of which the paper prints errors."""
    table = new_table(
        "Single runs: errors without sign, as Section 6.2 prints them",
        "",
        "x\n[mm]",
        "y\n[mm]",
        "theta\n[deg]",
        "x\n[%]",
        "y\n[%]",
        "theta\n[%]",
    )
    paper = paper_errors()
    for run in _printed_runs(study):
        name = run.case.name
        rows: list[tuple[str, Errors]] = [
            ("Adams / MATLAB, printed", paper.pushed if run.case == PUSHED else paper.tilted),
            ("MuJoCo / implicit", errors([run], lambda run: run.implicit)),
            ("MuJoCo / explicit", errors([run], lambda run: run.explicit)),
        ]
        for k, (who, error) in enumerate(rows):
            table.add_row(
                f"{name}, {who}",
                *numbers(np.abs(error.absolute[0])),
                *numbers(np.abs(error.percent[0])),
                end_section=k == 2,
            )
    return table


def beside_adams(study: Study) -> Table:
    """Displacements after 1 s: Adams's own, as far as they can be told, and ours."""
    table = new_table(
        "Displacements after 1 s, without sign; Adams's are what its printed errors in mm, deg "
        "and % leave open",
        "",
        "",
        "x [m]",
        "y [m]",
        "theta [deg]",
        labels=2,
    )
    for run in _printed_runs(study):
        adams = printed("v09" if run.case == PUSHED else "gamma10")
        shown = [
            f"{low:.{digits}f} to {high:.{digits}f}"
            for low, high, digits in zip(adams.low, adams.high, (3, 3, 2), strict=True)
        ]
        table.add_row(run.case.name, "Adams", *shown)
        for name, trajectory in (
            ("MuJoCo", run.mujoco),
            ("implicit, 1 ms", run.implicit),
            ("explicit, 5 ms", run.explicit),
        ):
            x, y, theta = np.abs(displacement(trajectory))
            table.add_row("", name, f"{x:.3f}", f"{y:.3f}", f"{theta:.2f}")
        table.add_section()
    return table


def _printed_runs(study: Study) -> list[Run]:
    """Figure 12a, if the sweep holds it, and 12b."""
    return [*(run for run in study.sweep if run.case.tilt == 10.0), study.pushed]
