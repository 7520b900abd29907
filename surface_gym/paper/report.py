"""A reproduction as tables on a terminal."""

from collections.abc import Iterator

from rich.console import Console
from rich.table import Table as TextTable
from rich.text import Text

from surface_gym.paper import report_claims, report_tables
from surface_gym.paper.framing import COARSE_NAME, NAMES, framed
from surface_gym.paper.integration import COARSE, CONVERGED, SMOOTH
from surface_gym.paper.reproduction import Reproduction
from surface_gym.paper.targets import load_targets


def print_report(reproduction: Reproduction, console: Console) -> None:
    """Print every table, the sorting rates, how many cells agree, and what the steps do."""
    console.print(
        f"{load_targets().source}\n\n"
        f"The paper prints no step. Ours at {COARSE_NAME} ({COARSE}), which we infer that it took, "
        f"and converged ({CONVERGED}).\n"
        "* differs from the paper; / is the paper's mark for a task that fails.\n"
        "Where Eq. (1) has no solution the box would tip; taken instead are the forces that bear "
        "its weight and come nearest to the moments. Shares of the steps up to the value stand "
        f"below each table, as well by the method that does not chatter ({SMOOTH}).\n",
        highlight=False,
    )
    for part in _parts(reproduction):
        console.print(part)
        console.print()
    for line in _steps(reproduction):
        console.print(line, highlight=False)


def _parts(reproduction: Reproduction) -> Iterator[TextTable]:
    yield from map(report_tables.table_of, reproduction.tables)
    yield report_tables.rates(reproduction)
    yield report_claims.self_stops(reproduction.self_stopping)
    yield report_claims.alignment(reproduction.alignment)
    yield _counts(reproduction)
    yield report_claims.other_steps(reproduction)


def _counts(reproduction: Reproduction) -> TextTable:
    result = framed("Cells that agree")
    result.add_column("")
    for name in ("cells", *NAMES):
        result.add_column(name, justify="right")
    for table in reproduction.tables:
        counts = (len(table.cells), *map(table.agreeing, range(len(NAMES))))
        result.add_row(Text(table.title), *map(str, counts))
    return result


def _steps(reproduction: Reproduction) -> Iterator[str]:
    for spread in reproduction.near_the_limit:
        yield (
            f"Table 2, converged against {spread.integrations[1]}: "
            f"at most {spread.position:.1f} mm and {spread.angle:.2f}° apart."
        )
    about = reproduction.about_coarse
    steps = [1000 * integration.dt for integration in about.integrations]
    yield (
        f"Table 2, explicit steps of {min(steps):g} to {max(steps):g} ms: "
        f"up to {about.position:.0f} mm and {about.angle:.1f}° apart; the sign function chatters."
    )
    last = reproduction.last_digits
    yield (
        f"Table 2, {COARSE}, all axes turned by 4e-15 rad either way: up to "
        f"{last.position:.0f} mm and {last.angle:.1f}° apart; cos(90°) as computers round it is "
        "off by as little."
    )
