"""What the tables tell of the step, and two claims of the paper, on a terminal."""

from collections.abc import Iterator, Sequence

from rich.table import Table as TextTable
from rich.text import Text

from surface_gym.paper.alignment import INWARDS, OFFSETS, TURNS, Aligned
from surface_gym.paper.framing import framed, marked
from surface_gym.paper.reproduction import Reproduction
from surface_gym.paper.standstill import SelfStop
from surface_gym.paper.steps import Agreement


def other_steps(reproduction: Reproduction) -> TextTable:
    """How many cells agree, by step."""
    tables = [reproduction.table(key) for key in reproduction.by_step[0].agreeing]
    result = framed(
        "The paper prints no step: cells that agree by explicit steps of",
        f"The most that one step brings is {_most(reproduction.by_step)}. That the paper took "
        "about 5 ms is our inference.",
    )
    result.add_column("step")
    for table in tables:
        name = table.title.partition(":")[0]
        result.add_column(f"{name}, of {len(table.cells)}", justify="right")
    result.add_column("all", justify="right")
    for each in reproduction.by_step:
        counts = list(each.agreeing.values())
        result.add_row(f"{1000 * each.integration.dt:g} ms", *map(str, counts), str(sum(counts)))
    return result


def _most(by_step: Sequence[Agreement]) -> str:
    most = max(sum(each.agreeing.values()) for each in by_step)
    steps = [
        f"{1000 * each.integration.dt:g}" for each in by_step if sum(each.agreeing.values()) == most
    ]
    return f"{most}, at {' and '.join(steps)} ms"


def self_stops(cases: Sequence[SelfStop]) -> TextTable:
    """Up to which tilt a pushed box stops by itself."""
    result = framed(
        "Section 6.2: steepest tilt at which the S-box stops by itself",
        "expected: tan = sqrt(2) mu_min where all axes stand at +45°, tan = (mu_max + mu_min) / "
        "sqrt(2) in alternate rows. The paper's sin = mu_min / sqrt(2) leaves out the part along "
        "x of the friction along the axes.",
    )
    result.add_column("axes")
    for name in ("paper", "expected", *(str(case.integration) for case in cases[:2])):
        result.add_column(name, justify="right")
    for case, other in zip(cases[::2], cases[1::2], strict=True):
        result.add_row(
            case.layout,
            "" if case.study is None else f"{case.study:.2f}°",
            *(f"{tilt:.2f}°" for tilt in (case.expected, case.measured, other.measured)),
        )
    return result


def alignment(cases: Sequence[Aligned]) -> TextTable:
    """Where boxes that come off the middle or turned leave a zone at +-45 deg."""
    result = framed(
        "Section 5.2: do rows at ±45° in turn align a box? Implicit, 1 ms",
        "As it leaves the zone, or rests in it: off the middle [mm] if it came straight, turned "
        "[°] if it came in the middle; * no nearer than it came. Both: of those that came off "
        "the middle and turned, how many end nearer by a tenth in both.",
    )
    result.add_column("rows push,\ncolumns, v0")
    result.add_column("\ntilt", justify="right")
    for offset in OFFSETS:
        result.add_column(f"from\n{1000 * offset:.0f} mm", justify="right")
    for turn in TURNS:
        result.add_column(f"from\n{turn:.0f}°", justify="right")
    result.add_column("\nboth", justify="right")
    size = cases[0].zone.size
    for case in cases:
        zone = case.zone
        if zone.size != size:
            result.add_section()
        size = zone.size
        towards = "inwards" if zone.towards == INWARDS else "outwards"
        result.add_row(
            f"{zone.size} {towards}, {zone.columns}, {zone.speed:g}",
            f"{zone.tilt:g}°",
            *(_end(1000 * end[0], 1000 * came) for end, came in _pairs(case.straight, OFFSETS)),
            *(_end(end[1], came) for end, came in _pairs(case.centred, TURNS)),
            f"{case.nearer}/{case.mixed}",
        )
    return result


def _pairs(
    ends: Sequence[tuple[float, float]], came: Sequence[float]
) -> Iterator[tuple[tuple[float, float], float]]:
    return zip(ends, came, strict=True)


def _end(value: float, came: float) -> Text:
    """To a tenth, marked where it is not nearer than it came."""
    return marked(f"{value:.1f}", round(abs(value), 1) < came)
