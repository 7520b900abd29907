"""`surface-gym design`: questions, flags and printed answers."""

import csv
import json
import math
import re
import sys
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import reduce
from importlib import import_module
from operator import or_
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table as ScreenTable

import surface_gym as sg
from surface_gym import checks, design, files, parallel
from surface_gym.cli import parse_options
from surface_gym.executors import WorkError

if TYPE_CHECKING:
    from surface_gym.design.case import Answer, Cell, ReportTable
    from surface_gym.design.runs import OnProgress
    from surface_gym.parcel import Base

STOPPED = 130  # exit status after Ctrl-C
DPI = 120  # of figures
ZONE = 16  # default columns of a searched layout
MASS = (
    "Mass cancels out of the motion: these answers hold for any mass. Only the inertia over the "
    "mass counts, and by itself it goes with the base."
)
MIX = "S, B or LENGTHxWIDTH in m, with odds, as S=1,B=2,0.3x0.4"
EXITS = "sides, chutes, or a list as left:1.0-2.5,right:1.0-2.5,straight"
SPEEDS = (0.1, 20.0)  # [m/s]
_SPAN = re.compile(r"((?P<side>left|right)[^:]*):(?P<first>[^-:]+)-(?P<last>[^-:]+)")

Degrees = Annotated[float, tyro.conf.arg(metavar="DEG")]
MaybeDegrees = Annotated[float | None, tyro.conf.arg(metavar="DEG")]
MaybeFloat = Annotated[float | None, tyro.conf.arg(metavar="FLOAT")]
MaybeInt = Annotated[int | None, tyro.conf.arg(metavar="INT")]


class Question:
    """A question that the command answers. `out` is the folder for the answer's files."""

    out: Path

    @property
    def assumed(self) -> str:
        """Sentence about assumed values, or ""."""
        return ""

    @property
    def remark(self) -> str:
        """Sentence about flags without an effect, or ""."""
        return ""

    @abstractmethod
    def check(self) -> Any:
        """Return the design case that the flags describe. Raise a ValueError for invalid flags."""

    @abstractmethod
    def answer(self, on_progress: "OnProgress") -> "Answer":
        """Find the answer. `on_progress` is called with the finished and the total work."""

    def write(self, answer: Any) -> list[Path]:
        """Write additional files, and return their paths. The default is to write no files."""
        del answer
        return []


@dataclass(frozen=True)
class ParcelQuestion(Question):
    """A question about a parcel, its entry, its purpose and the unknown quantities.

    Values of `Unknown`, `STEP` and `Effort` are copied here, since their import slows `--help`.
    """

    parcel: Annotated[str | None, tyro.conf.arg(metavar="LxW")] = None
    """Rectangular base, length (along the line) x width in m, e.g. 0.3x0.4; S and B are the study's
    boxes.
    """
    disc: Annotated[float | None, tyro.conf.arg(metavar="RADIUS")] = None
    """Radius of a round base [m]."""
    polygon: Annotated[str | None, tyro.conf.arg(metavar="'X,Y X,Y X,Y'")] = None
    """Corners of a convex base [m], e.g. '0,0 0.3,0 0.2,0.25'."""
    mass: MaybeFloat = None
    """Mass [kg]. It has no effect on the motion unless --inertia is given."""
    inertia: MaybeFloat = None
    """Moment of inertia [kg m^2] about the vertical axis through the centre of mass; the default
    assumes an even load.
    """
    com_offset: tuple[float, float] = (0.0, 0.0)
    """Centre of mass [m] from the base's centroid."""
    com_height: float = 0.1
    """Height [m] of the centre of mass above the base."""

    purpose: Literal["sort", "slow", "stop", "turn"] = "sort"
    """Task of the surface."""
    side: Literal["right", "left"] = "right"
    """Sort: goal side of the line, seen along the motion."""
    ratio: MaybeFloat = None
    """Slow: goal ratio of exit and entry speed, an upper limit without --tolerance; the default is
    0.5.
    """
    place: MaybeFloat = None
    """Stop: goal position [m] of the base's middle from the zone's start; the default is anywhere
    in the zone.
    """
    angle_deg: MaybeDegrees = None
    """Turn: goal angle [deg], anti-clockwise; the default is 30."""
    tolerance: MaybeFloat = None
    """Allowed error of the ratio, the place [m] or the angle [deg]."""

    speed: MaybeFloat = None
    """Entry speed [m/s]; the default is 1."""
    tilt_deg: Degrees = 0.0
    """Tilt of the surface [deg], downhill along the line."""
    pitch: Annotated[str, tyro.conf.arg(metavar="P or PXxPY")] = "0.1"
    """Distance of neighbours [m]: one number, or along the line x across it, e.g. 0.1x0.12."""
    mu_max: float = 0.5
    """Friction along a rotor's axis."""
    mu_min: float = 0.01
    """Friction across a rotor's axis."""
    mu_support: float = 0.005
    """Friction of a support."""
    columns: MaybeInt = None
    """Columns of the zone; the default is the fewest that succeed in 95 % of the draws."""
    rows: MaybeInt = None
    """Rows of rotors; the default is the rows under the parcel."""

    friction: float = 0.2
    """Unknown: maximum relative change of mu_max."""
    rolling: float = 0.2
    """Unknown: maximum relative change of mu_min and mu_support."""
    com_spread: float = 0.1
    """Unknown: maximum offset of the centre of mass, relative to half the base."""
    mass_spread: float = 0.0
    """Unknown: maximum relative change of the mass at a given inertia."""
    unevenness: float = 0.35
    """Unknown: log-normal spread of the elements' stiffness; 0.35 is about 1 micrometre."""
    lateral: float = 0.0
    """Unknown: standard deviation of the lateral entry position [m]."""
    heading_deg: Degrees = 0.0
    """Unknown: standard deviation of the heading [deg]."""
    speed_spread: float = 0.0
    """Unknown: standard deviation of the entry speed [m/s]."""
    tilt_spread_deg: Degrees = 0.0
    """Unknown: standard deviation of the tilt [deg]."""
    draws: int = 100
    """Number of draws of the unknown quantities."""
    seed: int = 0
    """Seed of the draws."""
    step: float = 0.005
    """Time step [s] of the simulation."""

    workers: int = field(default_factory=parallel.usable_cores)
    """Number of threads; results do not depend on it."""
    cluster: str | None = None
    """Address of a Ray cluster to use instead; "auto" for a local cluster."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/design")
    """Folder for the tables and the figure."""

    @property
    def assumed(self) -> str:
        if self.speed is not None:
            return ""
        return f" Without --speed, an entry speed of {design.Case.speed:g} m/s is assumed."

    @property
    def remark(self) -> str:
        return MASS if self.mass is not None and self.inertia is None else ""

    @property
    def shared_by(self) -> parallel.Workers:
        return parallel.choose_workers(self.cluster, self.workers)

    def check(self) -> "design.Case":
        _ = self.shared_by
        unknown = design.Unknown(
            friction=self.friction, rolling=self.rolling, com_offset=self.com_spread,
            mass=self.mass_spread, stiffness=self.unevenness, lateral=self.lateral,
            heading=math.radians(self.heading_deg), speed=self.speed_spread,
            tilt=math.radians(self.tilt_spread_deg),
        )  # fmt: skip
        alike = ("draws", "seed", "mu_max", "mu_min", "mu_support", "step")
        return design.Case(
            parcel=self._parcel(),
            purpose=self._purpose(),
            speed=design.Case.speed if self.speed is None else self.speed,
            tilt=math.radians(self.tilt_deg),
            unknown=unknown,
            pitch=self._pitch(),
            **{name: getattr(self, name) for name in alike},
        )

    def _parcel(self) -> "sg.Parcel":
        given = [name for name in ("parcel", "disc", "polygon") if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(f"--{name}" for name in given) or "none"
            raise ValueError(f"parcel must be one of --parcel, --disc and --polygon, got {found}")
        return sg.Parcel(
            base=self._base(),
            mass=10.0 if self.mass is None else self.mass,
            com_height=self.com_height,
            inertia=self.inertia,
            com_offset=self.com_offset,
        )

    def _base(self) -> "Base":
        if self.disc is not None:
            return sg.Disc(self.disc)
        if self.polygon is not None:
            corners = [corner.split(",") for corner in self.polygon.split()]
            if any(len(corner) != 2 for corner in corners):
                raise ValueError(f"polygon must be 'X,Y X,Y X,Y', got {self.polygon!r}")
            import numpy as np

            return sg.Polygon(np.array([_numbers("polygon", corner) for corner in corners]))
        assert self.parcel is not None
        if self.parcel in ("S", "B"):
            return sg.layouts.box(self.parcel).base
        return _parse_base("parcel", self.parcel, "LxW as 0.3x0.4, S or B", self.parcel)

    def _purpose(self) -> "design.Purpose":
        given: dict[str, Any] = {
            name: getattr(self, name)
            for name in ("ratio", "place", "angle_deg", "tolerance")
            if getattr(self, name) is not None
        }
        kinds = (design.SortPurpose, design.SlowPurpose, design.StopPurpose, design.TurnPurpose)
        kind: Any = next(each for each in kinds if each.name == self.purpose)
        own = {each.name for each in fields(kind)}
        for name in given:
            if name.removesuffix("_deg") not in own:
                raise ValueError(f"{name} must not be given to {self.purpose}")
        if self.purpose == "stop" and set(given) == {"tolerance"}:
            raise ValueError("tolerance must be given with --place only, to stop")
        if self.purpose == "sort":
            given["side"] = -1 if self.side == "right" else 1
        if self.purpose == "turn":
            given = {name.removesuffix("_deg"): math.radians(x) for name, x in given.items()}
        found: design.Purpose = kind(**given)
        return found

    def _pitch(self) -> float | tuple[float, float]:
        parts = _numbers("pitch", self.pitch.split("x"))
        if len(parts) > 2:
            raise ValueError(f"pitch must be one number or two as 0.1x0.12, got {self.pitch!r}")
        return parts[0] if len(parts) == 1 else (parts[0], parts[1])


def _numbers(name: str, parts: Sequence[str]) -> list[float]:
    return [files.parse_number(f"each part of {name}", part) for part in parts]


@dataclass(frozen=True)
class AskColumns(ParcelQuestion):
    """Find the fewest columns and rows of modules that fulfil the parcel's purpose."""

    def answer(self, on_progress: "OnProgress") -> "Answer":
        if self.columns is not None:
            raise ValueError("columns must not be given: they are what is asked for")
        from surface_gym.design.columns import columns_report

        return columns_report(self.check(), self.rows, self.shared_by, on_progress)


@dataclass(frozen=True)
class AskSpeed(ParcelQuestion):
    """Find the smallest and the largest entry speed."""

    highest: MaybeFloat = None
    """Highest entry speed to try [m/s]; the default is 3, or 1.5 times --speed."""

    def answer(self, on_progress: "OnProgress") -> "Answer":
        return design.least_speed(
            self.check(), self.columns, self.rows, self.highest, self.shared_by, on_progress
        )


@dataclass(frozen=True)
class AskTilt(ParcelQuestion):
    """Find the smallest and the largest tilt. With --speed 0, the parcel starts at rest."""

    highest_deg: MaybeDegrees = None
    """Highest tilt to try [deg]; the default is 15, or 1.5 times --tilt-deg."""

    def answer(self, on_progress: "OnProgress") -> "Answer":
        highest = None if self.highest_deg is None else math.radians(self.highest_deg)
        return design.least_tilt(
            self.check(), self.columns, self.rows, highest, self.shared_by, on_progress
        )


@dataclass(frozen=True)
class AskFriction(ParcelQuestion):
    """Find the smallest and largest friction, along and across axes, at which the zone works."""

    def answer(self, on_progress: "OnProgress") -> "Answer":
        return design.friction_range(
            self.check(), self.columns, self.rows, self.shared_by, on_progress
        )


@dataclass(frozen=True)
class AskLoad(ParcelQuestion):
    """Find the largest load of a module, and the heaviest parcel that the modules bear."""

    limit: float = 20.0
    """Load [kg] that a module bears; the default is the study's."""

    @property
    def remark(self) -> str:
        return ""

    def answer(self, on_progress: "OnProgress") -> "Answer":
        return design.module_loads(
            self.check(), self.columns, self.rows, self.limit, self.shared_by, on_progress
        )


@dataclass(frozen=True)
class AskLayout(ParcelQuestion):
    """Search for the fixed layout that is best over a range of entry speeds."""

    speeds: tuple[float, float] = (0.3, 2.7)
    """Smallest and largest entry speed [m/s]; --speed has no effect."""
    speed_step: float = 0.02
    """Step of the entry speeds [m/s]."""
    any_angle: bool = False
    """Search any axis angles, not only 0, 45, -45 and 90 deg."""
    members: int = 40
    """Layouts in the population of the search."""
    epochs: int = 12
    """Epochs of the search, of ten generations each."""

    @property
    def assumed(self) -> str:
        return ""

    def answer(self, on_progress: "OnProgress") -> "Answer":
        import numpy as np

        from surface_gym.design.fixed_layout import Effort

        case = self.check()
        least, most = self.speeds
        step = checks.positive("speed_step", self.speed_step, 1e-4, 20.0)
        if not least <= most:
            raise ValueError(f"speeds must be the least and the most, got {self.speeds!r}")
        speeds = least + step * np.arange(math.floor((most - least) / step + 1e-6) + 1)
        return design.best_layout(
            case, speeds.round(9).tolist(), ZONE if self.columns is None else self.columns,
            self.rows, None if self.any_angle else sg.lines.ORIENTATIONS,
            Effort(members=self.members, epochs=self.epochs), self.shared_by, on_progress,
        )  # fmt: skip


@dataclass(frozen=True)
class AskFlow(Question):
    """Find the shortest line and the fewest actuators for a rate of parcels."""

    rate: Annotated[float, tyro.conf.arg(metavar="PER_HOUR")]
    """Throughput in parcels per hour, each delivered to its own exit."""
    mix: Annotated[str, tyro.conf.arg(metavar="S=1,B=1")] = "S"
    """Parcels and their odds, e.g. "S=2,0.3x0.4=1": S and B are the study's boxes, others are
    length x width in m.
    """
    exits: Annotated[str, tyro.conf.arg(metavar="EXITS")] = "sides"
    """Exits with equal odds: sides, chutes, or a list of positions [m] from the line's entry, e.g.
    left:1.0-2.5,right:1.0-2.5,straight. Sides and chutes are as long as the line.
    """
    speed: Annotated[tuple[float, ...], tyro.conf.arg(metavar="SPEED [SPEED]")] = (1.5,)
    """Entry speed [m/s]: one number, or the smallest and the largest."""
    longest: float = 6.0
    """Longest line to try [m]."""
    turn_energy: float = 0.0
    """Energy of a turn of an actuator [J], by its data sheet: adds a table of energy and life."""
    turn_life: float = math.inf
    """Turns of an actuator until it fails, by its data sheet: adds the same table."""
    driven: bool = False
    """Find lines of driven modules, too, and what an idle line saves beside them."""

    workers: int = field(default_factory=parallel.usable_cores)
    """Number of processes; results do not depend on it."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/design")
    """Folder for the tables and the figure."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File for all numbers as JSON."""

    def check(self) -> Any:
        parallel.check_count("workers", self.workers)
        if len(self.speed) not in (1, 2):
            raise ValueError(f"speed must be one number or two, got {self.speed!r}")
        for each in self.speed:
            checks.positive("speed", each, *SPEEDS)
        if self.speed[0] > self.speed[-1]:
            raise ValueError(f"speed must be the least and then the greatest, got {self.speed!r}")
        speed = self.speed[0] if len(self.speed) == 1 else self.speed
        return import_module("surface_gym.agents.scheduling.design").FlowCase(
            self.rate, parse_mix(self.mix), parse_exits(self.exits), speed, self.longest,
            self.turn_energy, self.turn_life, self.driven,
        )  # fmt: skip

    def answer(self, on_progress: "OnProgress") -> "Answer":
        module = import_module("surface_gym.agents.scheduling.flow_answer")
        found: Answer = module.answer_flow(self.check(), self.workers, on_progress)
        return found

    def write(self, answer: Any) -> list[Path]:
        if self.json is None:
            return []
        text = json.dumps(answer.as_json(), indent=1) + "\n"
        self.json.write_text(text, encoding="utf-8")
        return [self.json]


def parse_mix(text: str) -> tuple[tuple[Any, float], ...]:
    """Parse parcels and their odds, e.g. "S=1,0.3x0.4=2". The default of odds is 1."""
    found = []
    for part in text.split(","):
        name, _, odds = (each.strip() for each in part.partition("="))
        base = None if name in ("S", "B") else _parse_base("mix", name, MIX, text)
        parcel = name if base is None else sg.Parcel(base)
        found.append((parcel, files.parse_number("odds of mix", odds) if odds else 1.0))
    return tuple(found)


def _parse_base(flag: str, name: str, form: str, given: str) -> "Base":
    """Parse the base `name`, written as LENGTHxWIDTH [m].

    An error says that the flag `flag` must have the form `form`, and quotes the text `given`.
    """
    sides = name.split("x")
    if len(sides) != 2:
        raise ValueError(f"{flag} must be {form}, got {given!r}")
    return sg.Rectangle(*_numbers(flag, sides))


def parse_exits(text: str) -> Any:
    """Parse a list of exits such as `left:1.0-2.5,straight`. Return a preset's name unchanged."""
    from surface_gym.flow.exits import EXITS as PRESETS, Exit, Exits

    if text in PRESETS:
        return text
    found = []
    for part in map(str.strip, text.split(",")):
        span = _SPAN.fullmatch(part)
        if part == "straight":
            found.append(Exit(part, 0))
        elif span is None:
            raise ValueError(f"exits must be {EXITS}, got {text!r}")
        else:
            first, last = (files.parse_number("each span of exits", span[x]) for x in (3, 4))
            try:
                found.append(Exit(span[1], 1 if span["side"] == "left" else -1, first, last))
            except ValueError as error:
                raise ValueError(f"exits must be {EXITS}, got {text!r}: {error}") from None
    return Exits(tuple(found))


QUESTIONS = {
    "columns": AskColumns,
    "speed": AskSpeed,
    "tilt": AskTilt,
    "friction": AskFriction,
    "load": AskLoad,
    "layout": AskLayout,
    "flow": AskFlow,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. If there is an error, print it on one line and exit with status 2."""
    kinds: Any = tuple(
        Annotated[kind, tyro.conf.subcommand(name, prefix_name=False)]
        for name, kind in QUESTIONS.items()
    )
    question = parse_options(
        reduce(or_, kinds),
        "design",
        arguments,
        description="Which surface does a parcel of your own need, or a stream of them?",
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    import_module("matplotlib.figure")  # needed last, but a missing library is reported first
    try:
        ask(question)
    except (ValueError, OSError, ImportError, WorkError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        raise SystemExit(STOPPED) from None


def ask(question: Question) -> None:
    """Print the answer to a question. Write tables (CSV) and a figure to `question.out`."""
    question.check()  # report errors before making the folder
    question.out.mkdir(parents=True, exist_ok=True)
    started = perf_counter()
    answer = _find_answer(question)
    took = perf_counter() - started
    tables = answer.tables()
    paths = [write_csv(table, question.out) for table in tables]
    paths.append(question.out / f"{answer.name}.png")
    answer.draw().savefig(paths[-1], dpi=DPI)
    paths += question.write(answer)
    console = Console()
    sentence = f"{answer.sentence.removesuffix('.')}.{question.assumed}"
    console.print(escape(sentence), highlight=False, soft_wrap=True)
    if question.remark:
        console.print(escape(question.remark), highlight=False, soft_wrap=True)
    console.print()
    for table in tables:
        if table.shown:
            console.print(_screen_table(table))
    console.print(
        f"{took:.1f} s; written:", *map(str, paths), sep="\n", highlight=False, soft_wrap=True
    )


def _find_answer(question: Question) -> "Answer":
    """Find the answer, with a progress bar in a terminal."""
    console = Console(stderr=True)
    bars = (TextColumn("working it out"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(
        *bars, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        bar = progress.add_task("", total=None)
        return question.answer(
            lambda done, total: progress.update(bar, completed=done, total=total)
        )


def _screen_table(table: "ReportTable") -> ScreenTable:
    screen = ScreenTable(
        title=escape(table.title), title_justify="left", box=SIMPLE_HEAD, pad_edge=False,
        collapse_padding=True,
    )  # fmt: skip
    for k, name in enumerate(table.header):
        words = any(isinstance(row[k], str) for row in table.rows)
        screen.add_column(escape(name), justify="left" if words else "right")
    for row in table.rows:
        screen.add_row(*(escape(format_cell(cell)) for cell in row))
    return screen


def format_cell(cell: "Cell") -> str:
    """Format a cell for a terminal."""
    if _is_missing(cell):
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)


def write_csv(table: "ReportTable", folder: Path) -> Path:
    """Write a table with full precision to a CSV file in a folder; return the file's path."""
    path = folder / f"{table.name}.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table.header)
        for row in table.rows:
            writer.writerow("" if _is_missing(cell) else cell for cell in row)
    return path


def _is_missing(cell: "Cell") -> bool:
    return cell is None or (isinstance(cell, float) and math.isnan(cell))
