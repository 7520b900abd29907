"""What a decision takes: measured, and so the only part of a comparison that is never the same."""

from collections.abc import Sequence
from pathlib import Path

from .table import NOTHING, Summaries, Table, markdown
from .trials import Trial

FILE = "decisions.md"
TOLD = (
    "time of one lane's decision [us], decided many at a time, median; "
    "it differs from run to run, as nothing else here does"
)


def decision_table(trials: Sequence[Trial], summaries: Summaries) -> Table:
    """A row a contender, a column a task, exact sensors."""
    names = list(dict.fromkeys(who for _, who, _ in summaries))
    rows = [(who, *(_time(summaries, trial.name, who) for trial in trials)) for who in names]
    return Table("decisions", TOLD, ("controller", *(trial.label for trial in trials)), tuple(rows))


def write_decisions(table: Table, folder: Path) -> None:
    """Write it into a file of its own, so that the others can be compared byte for byte."""
    (folder / FILE).write_text(markdown(table))


def _time(summaries: Summaries, task: str, who: str) -> str:
    summary = summaries.get((task, who, "exact"))
    return NOTHING if summary is None else f"{1e6 * summary.decision_time:.1f}"
