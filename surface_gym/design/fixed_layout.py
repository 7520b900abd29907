"""The best fixed layout for a purpose over many entry speeds, compared with the study's layouts.

The search uses no derivatives, because a layout is dozens of integers, and the cost jumps where a
parcel only just leaves the line. SciPy's differential evolution improves a population of layouts,
called members. Then a descent tries other axes for one column after another.

`python -m surface_gym.design.fixed_layout` repeats the search of the shipped sorting layouts.
"""

import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path

import numpy as np

from surface_gym import checks, files, layouts, lines, parallel
from surface_gym.design import case as cases
from surface_gym.design.case import Case, SortPurpose
from surface_gym.design.runs import LONGEST, DesignLine, Ends, OnProgress, make_runs
from surface_gym.physics.types import Array, Booleans

Score = Callable[[Array], Array]  # costs (layouts,) of axes (layouts, rows, columns) [rad]

NEAR, HASTE = 0.9, 0.09  # [-] maximum cost of shortfall and of time relative to a failure
AT_ONCE = 4096  # approximate number of runs of `every_layout` at a time
STROKE = 0.38  # [pitches] half length of an axis' stroke
RECOMBINATION = 0.3  # [-] share of a layout's modules that a trial changes
CHANGES = (0.1, 0.3, 0.6)  # [-] share of modules changed in copies of the initial layouts
QUARTER = math.pi / 2.0
DECIMALS = 2  # decimals of degrees if any angle is allowed
ALL_AT_ONCE = 256  # maximum arrangements of a column tried together; above, module by module
# [rad] changes tried if any angle is allowed
SHIFTS = np.radians([-22.5, -5.0, -1.0, 1.0, 5.0, 22.5])
SPEEDS = np.arange(30, 271, 2) / 100.0  # [m/s] speeds of the search
COLUMNS = 16  # columns of the zone
SIDE = -1  # sorting direction: y < 0
FILE = "data/sorting.json"
# [rad] allowed axes: the study's, every 22.5 deg, or any.
OFFERS: dict[str, tuple[float, ...] | None] = {
    "four": lines.ORIENTATIONS,
    "eight": tuple(math.pi / 2.0 - math.pi / 8.0 * place for place in range(8)),
    "any": None,
}
SIZES = ("S", "B")


@dataclass(frozen=True, eq=False)
class LayoutResult:
    """Results of a layout at several entry speeds."""

    name: str
    axis: Array  # (rows, columns) [rad] axes of the zone
    speeds: Array  # (speeds,) [m/s] in ascending order
    success: Booleans  # (speeds,) success with nothing unknown
    time: Array  # (speeds,) [s] duration of the run
    measure: Array  # (speeds,) see `Purpose.measure`; NaN: none
    share: Array  # (speeds,) [-] share of successful draws of the unknown quantities

    @property
    def successes(self) -> float:
        """[-] share of the speeds at which the layout succeeds."""
        return float(self.success.mean())

    @property
    def least_speed(self) -> float:
        """Lowest speed [m/s] without failures at this or higher speeds, or NaN if there is none."""
        return self._least(self.success)

    @property
    def least_sure_speed(self) -> float:
        """[m/s] smallest speed `v` for which `v` and all higher speeds are reliable.

        A speed is reliable if at most 5 % of the draws fail at this speed. The result is NaN if the
        highest speed is not reliable.
        """
        return self._least(cases.is_reliable(self.share))

    @property
    def mean_time(self) -> float:
        """[s] mean duration of successful runs; NaN if no run succeeds."""
        return float(self.time[self.success].mean()) if self.success.any() else math.nan

    def _least(self, done: Booleans) -> float:
        first = len(done) - int(np.cumprod(done[::-1]).sum())
        return float(self.speeds[first]) if first < len(done) else math.nan


@dataclass(frozen=True, eq=False)
class BestLayout(cases.Answer):
    """The best fixed layout found, and the best of the study's layouts."""

    case: Case
    line: DesignLine
    best: LayoutResult
    study: LayoutResult

    name = "layout"

    @cached_property
    def changed(self) -> int:
        """Number of modules whose axes differ between the layouts `best` and `study`."""
        apart = np.abs(np.sin(self.best.axis - self.study.axis))
        return int((apart > 1e-9).sum())

    @property
    def sentence(self) -> str:
        best, study = self.best, self.study
        since, study_since = (
            "at none" if math.isnan(speed) else f"from {speed:.3g} m/s on"
            for speed in (best.least_speed, study.least_speed)
        )
        return (
            f"The best fixed layout found for {cases.plural(self.line.columns, 'column')} of "
            f"{self.line.rows} rows can {self.case.purpose.action}, a "
            f"{self.case.parcel_text}, at {best.successes:.1%} of {len(best.speeds)} speeds "
            f"from {best.speeds[0]:g} to {best.speeds[-1]:g} m/s, the study's at "
            f"{study.successes:.1%}; without a failure {since}, the study's {study_since}"
        )

    def tables(self) -> tuple[cases.ReportTable, ...]:
        both, purpose = (self.best, self.study), self.case.purpose
        axes = np.degrees(self.best.axis)
        columns = (f"column {k + 1} [deg]" for k in range(axes.shape[1]))
        speeds = [
            (each.name, float(speed), bool(done), float(share), purpose.scale * float(measure))
            for each in both
            for speed, done, share, measure in zip(
                each.speeds, each.success, each.share, each.measure, strict=True
            )
        ]
        return (
            cases.ReportTable(
                "layout",
                f"{self.changed} of {self.best.axis.size} modules differ from the study's",
                ("layout", "speeds that succeed", "all from [m/s]",
                 f"in {cases.SURE} of draws from [m/s]", "mean time [s]"),
                tuple(
                    (each.name, each.successes, each.least_speed, each.least_sure_speed,
                     each.mean_time)
                    for each in both
                ),
            ),
            cases.ReportTable(
                "layout_speeds",
                "By entry speed",
                ("layout", "speed [m/s]", "nothing unknown", "success",
                 f"{purpose.measured} [{purpose.unit}]"),
                tuple(speeds),
                shown=False,
            ),
            cases.ReportTable(
                "layout_axes",
                "Axes, the row at the greatest y first",
                ("row", *columns),
                tuple((len(axes) - k, *row) for k, row in enumerate(axes[::-1].tolist())),
                shown=False,
            ),
        )  # fmt: skip

    def draw(self) -> "cases.Figure":
        """Draw the axes of the two layouts, and the success of the two layouts over entry speed."""
        from matplotlib.ticker import PercentFormatter

        title = f"Which fixed layout for it to {self.case.purpose.passive}?"
        figure = cases.new_figure(8.0, 7.2, f"{title}\n{self.case.parcel_text}")
        tall = 0.8 + 0.12 * self.line.rows
        above, below, curves = figure.subplots(3, 1, height_ratios=(tall, tall, 2.4))
        looks = ((self.best, above, cases.BLUE, "-"), (self.study, below, cases.ORANGE, "--"))
        for each, axes, colour, style in looks:
            _draw_axes(axes, self.line, each, colour)
            curves.plot(
                each.speeds, each.share, color=colour, linewidth=1.8, linestyle=style,
                label=f"{each.name}, share of the draws",
            )  # fmt: skip
            curves.fill_between(
                each.speeds, each.success, step="mid", color=colour, alpha=0.15, linewidth=0.0,
                label=f"{each.name}, nothing unknown",
            )  # fmt: skip
        below.set_xlabel("x from the zone's start [m]")
        curves.axhline(1.0 - cases.WORST, color="black", linewidth=0.8)
        curves.set(xlabel="entry speed [m/s]", ylabel="success")
        curves.set_ylim(0.0, 1.03)
        curves.margins(x=0.0)
        curves.grid(alpha=0.25)
        curves.yaxis.set_major_formatter(PercentFormatter(1.0))
        figure.legend(*curves.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return figure


def _draw_axes(axes: "cases.Axes", line: DesignLine, layout: LayoutResult, colour: str) -> None:
    """Draw a layout's axes as strokes on matplotlib `axes`. Parcels roll across the strokes."""
    from matplotlib.collections import LineCollection

    from surface_gym.trajectory_plot import axis_strokes

    rows, columns = layout.axis.shape
    pitch = np.array([line.pitch_x, line.pitch_y])
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) - 0.5 * (rows - 1))
    centre = np.stack([x, y], axis=-1) * pitch
    strokes = axis_strokes(centre, layout.axis, STROKE * pitch.min())
    axes.add_collection(LineCollection(strokes, colors=colour, linewidths=2.5))
    axes.set(xlim=(0.0, columns * pitch[0]), ylim=(-0.5 * rows * pitch[1], 0.5 * rows * pitch[1]))
    axes.set(aspect="equal", ylabel="y [m]")
    axes.set_title(layout.name, fontsize="small")


@dataclass(frozen=True)
class LayoutSpace:
    """The searched layouts, written as members of a population.

    A member has one number per module, row by row. The number is an index into the orientations.
    If any angle is allowed, the number is the module's axis angle [rad].
    """

    rows: int
    columns: int
    orientations: tuple[float, ...] | None  # [rad] in ascending order; None: any

    @property
    def modules(self) -> int:
        return self.rows * self.columns

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest number that a member may have for a module."""
        return (-QUARTER, QUARTER) if self.orientations is None else (0, len(self.orientations) - 1)

    def axes(self, members: Array) -> Array:
        """Convert the layouts `members` (count, modules) to axes (count, rows, columns) [rad]."""
        shape = (len(members), self.rows, self.columns)
        if self.orientations is None:
            return np.radians(np.degrees(members).round(DECIMALS)).reshape(shape)
        return np.array(self.orientations)[np.rint(members).astype(int)].reshape(shape)

    def members(self, axes: Array) -> Array:
        """Return the members (layouts, modules) closest to axes (layouts, rows, columns) [rad]."""
        flat = axes.reshape(len(axes), -1)
        if self.orientations is None:
            return np.arctan(np.tan(flat))
        apart = np.abs(np.sin(flat[..., np.newaxis] - np.array(self.orientations)))
        return apart.argmin(axis=-1).astype(np.float64)

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Draw random members (count, modules)."""
        low, high = self.bounds
        if self.orientations is None:
            return rng.uniform(low, high, (count, self.modules))
        return rng.integers(0, len(self.orientations), (count, self.modules)).astype(np.float64)

    def neighbours(self, member: Array, column: int) -> Array:
        """Return members (count, modules) that differ from `member` (modules,) only in `column`."""
        own = np.arange(self.rows) * self.columns + column
        if self.orientations is None:
            one = SHIFTS[:, np.newaxis, np.newaxis] * np.eye(self.rows)
            every = SHIFTS[:, np.newaxis] * np.ones(self.rows)
            tried = member[own] + np.concatenate([one.reshape(-1, self.rows), every])
            tried = np.arctan(np.tan(tried))
        elif len(self.orientations) ** self.rows <= ALL_AT_ONCE:
            every_way = itertools.product(range(len(self.orientations)), repeat=self.rows)
            tried = np.array(list(every_way), dtype=np.float64)
        else:
            places = np.arange(len(self.orientations), dtype=np.float64)
            tried = np.tile(member[own], (self.rows, len(places), 1))
            tried[np.arange(self.rows), :, np.arange(self.rows)] = places
            tried = tried.reshape(-1, self.rows)
        around = np.tile(member, (len(tried), 1))
        around[:, own] = tried
        return around


@dataclass(frozen=True)
class Effort:
    """Length of a search."""

    members: int = 40  # size of the population
    generations: int = 10  # generations per epoch; progress is reported before every epoch
    epochs: int = 12
    rounds: int = 3  # rounds of the descent over all columns; it ends early without changes

    def __post_init__(self) -> None:
        for name, least in (("members", 5), ("generations", 1), ("epochs", 0), ("rounds", 0)):
            checks.integer(name, getattr(self, name), least)


def search(
    space: LayoutSpace, score: Score, known: Array, effort: Effort, seed: int,
    on_progress: OnProgress = lambda *_: None,
) -> Array:  # fmt: skip
    """Search for the axes (rows, columns) [rad] in `space` with the least cost.

    `score` returns the costs (layouts,) of layouts (layouts, rows, columns) [rad]. The search has
    two parts: differential evolution, and then a descent that changes one column at a time.
    `effort` sets the length of the two parts. The search starts from the layouts `known` (layouts,
    rows, columns) [rad] and from variations of these layouts, so the result costs no more than any
    of `known`. `on_progress` is called with the finished and total number of stages.
    """
    from scipy.optimize import differential_evolution

    remembered: dict[bytes, float] = {}

    def cost(members: Array) -> Array:
        """Return costs (members,) of layouts `members` (members, modules), cached if possible."""
        members = np.ascontiguousarray(members)
        names = [member.tobytes() for member in members]
        fresh = {name: k for k, name in enumerate(names) if name not in remembered}
        if fresh:
            found = score(space.axes(members[list(fresh.values())]))
            remembered.update(zip(fresh, found.tolist(), strict=True))
        return np.array([remembered[name] for name in names])

    steps = effort.epochs + effort.rounds * space.columns
    population = _begin(space, known, effort, seed)
    for epoch in range(effort.epochs):
        on_progress(epoch, steps)
        result = differential_evolution(
            lambda members: cost(members.T), [space.bounds] * space.modules, init=population,
            integrality=np.full(space.modules, space.orientations is not None),
            maxiter=effort.generations, recombination=RECOMBINATION, tol=0.0, polish=False,
            vectorized=True, updating="deferred", seed=np.random.default_rng((seed, epoch)),
        )  # fmt: skip
        population = np.array(result.population)
        if space.orientations is not None:
            population = np.rint(population)
        population = population[np.argsort(result.population_energies, kind="stable")]
    best, unchanged = population[0], 0
    for step in range(effort.rounds * space.columns):
        if unchanged == space.columns:
            break
        on_progress(effort.epochs + step, steps)
        # Take the best arrangement of the next column, with all other columns unchanged.
        around = np.vstack([best, space.neighbours(best, step % space.columns)])
        first = int(cost(around).argmin())
        best, unchanged = around[first], 0 if first else unchanged + 1
    on_progress(steps, steps)
    return space.axes(best[np.newaxis])[0]


def _begin(space: LayoutSpace, known: Array, effort: Effort, seed: int) -> Array:
    """Build the first population (members, modules) of `known` layouts and random variants."""
    rng = np.random.default_rng((seed, effort.epochs))
    members = space.members(known)[: effort.members]
    more = effort.members - len(members)
    changed = members[np.arange(more) % len(members)]
    share = np.array(CHANGES)[np.arange(more) % len(CHANGES), np.newaxis]
    changed = np.where(rng.random(changed.shape) < share, space.sample(rng, more), changed)
    return np.concatenate([members, changed])


def best_layout(
    case: Case, speeds: Sequence[float] | Array, columns: int = 16, rows: int | None = None,
    orientations: Sequence[float] | None = lines.ORIENTATIONS, effort: Effort = Effort(),
    workers: parallel.Workers = 1, on_progress: OnProgress = lambda *_: None,
) -> BestLayout:  # fmt: skip
    """Search for the zone's axes with the best result over all speeds.

    The best layout succeeds at the largest number of speeds. Among layouts with equal success, the
    best has the smallest cost. In the cost, `Purpose.shortfall` has ten times the weight of time.
    Modules that have no effect get the axes of the study's layout. `search` describes the method.

    The case's own entry speed is not used. To pass the zone is a failure if the purpose is to sort.
    `orientations` are the allowed axes [rad]. If `orientations` is None, all angles are allowed.
    The result does not depend on `workers`.
    """
    checks.integer("columns", columns, least=1)
    parallel.check_workers(workers)
    over = np.unique(checks.array("speeds", speeds, (None,)))
    if len(over) == 0 or over[0] <= 0.0:
        raise ValueError(f"speeds must be some above 0, got {over.tolist()}")
    offered = None
    if orientations is not None:
        offered = tuple(sorted(checks.orientations("orientations", np.array(orientations))))
    line = case.line(columns, rows)
    # Among the study's layouts with equal results, take the one with the most columns.
    kinds = [kind for used in range(columns, 0, -1) for kind in case.purpose.layouts(line, used)]
    score = _make_score(case, line, over, workers)
    study = kinds[int(score(np.stack([kind.axis for kind in kinds])).argmin())]
    space = LayoutSpace(line.rows, columns, offered)
    known = np.stack([*(kind.axis for kind in kinds), *case.purpose.search_starts(line)])
    known = np.unique(space.axes(space.members(known)), axis=0)
    first = np.argsort(score(known), kind="stable")[: effort.members // 2]
    axis = search(space, score, known[first], effort, case.seed, on_progress)
    axis = _tidy(axis, study.axis, score)
    return BestLayout(
        case=case,
        line=line,
        best=evaluate_layout("best fixed layout", axis, case, line, over, workers),
        study=evaluate_layout(study.name, study.axis, case, line, over, workers),
    )


def evaluate_layout(
    name: str, axis: Array, case: Case, line: DesignLine, speeds: Array,
    workers: parallel.Workers = 1,
) -> LayoutResult:  # fmt: skip
    """Evaluate a layout `axis` (rows, columns) [rad] of a line's zone at all `speeds` [m/s]."""
    axes = axis[np.newaxis]
    ends = _run_layouts(case, line, axes, speeds, workers)
    success = case.purpose.succeeds(ends)
    share = success.astype(np.float64)
    if case.unknown.groups:
        drawn = case.draw(line, case.unknown)
        for k, speed in enumerate(speeds.tolist()):
            each = drawn.runs(speed, case.tilt, line.columns)
            found = case.run(line, axes, each, drawn, workers)
            share[k] = case.purpose.succeeds(found).mean()
    measure = case.purpose.measure(ends)
    return LayoutResult(name, axis, speeds, success, ends.time, measure, share)


def _tidy(axis: Array, plain: Array, score: Score) -> Array:
    """Return the layout `axis` (rows, columns) [rad] after replacing axes by the axes of `plain`.

    An axis is replaced if the cost of the layout does not grow.
    """
    tidy = axis.copy()
    cost = score(tidy[np.newaxis])[0]
    for column in reversed(range(axis.shape[1])):
        for row in range(axis.shape[0]):
            tried = tidy.copy()
            tried[row, column] = plain[row, column]
            if score(tried[np.newaxis])[0] <= cost:
                tidy = tried
    return tidy


def _run_layouts(
    case: Case, line: DesignLine, axes: Array, speeds: Array, workers: parallel.Workers
) -> Ends:
    """Run layouts `axes` (layouts, rows, columns) [rad]. Runs are sorted by layout, then speed."""
    runs = make_runs(
        speed=np.tile(speeds, len(axes)),
        tilt=case.tilt,
        layout=np.repeat(np.arange(len(axes)), len(speeds)),
        columns=line.columns,
    )
    return case.run(line, axes, runs, workers=workers)


def _make_score(case: Case, line: DesignLine, speeds: Array, workers: parallel.Workers) -> Score:
    """Return a function that computes costs (layouts,) of layouts (layouts, rows, columns) [rad].

    The cost of a layout has three parts. Each speed at which the layout fails costs 1. The mean of
    `Purpose.shortfall` over all speeds costs at most `NEAR`. The mean time of the successful runs
    costs at most `HASTE`.
    """

    def score(axes: Array) -> Array:
        ends = _run_layouts(case, line, axes, speeds, workers)
        shape = (len(axes), len(speeds))
        failed = ~case.purpose.succeeds(ends).reshape(shape)
        short = case.purpose.shortfall(ends).reshape(shape)
        time_taken = ends.time.reshape(shape) / LONGEST
        done = np.maximum(1, (~failed).sum(axis=1))
        haste = np.where(failed, 0.0, time_taken).sum(axis=1) / done
        return failed.sum(axis=1) + NEAR * short.mean(axis=1) + HASTE * haste

    return score


def every_layout(
    case: Case, columns: int = 16, rows: int | None = None,
    orientations: Sequence[float] = lines.ORIENTATIONS, most: int = 1_000_000,
) -> Array | None:  # fmt: skip
    """Try the layouts of a zone at the case's speed until a layout succeeds.

    All quantities have their nominal values. A zone of two rows and 16 columns has 4^32 layouts.
    But columns that a parcel does not touch have no effect, so the search sets only columns that
    the parcel reaches.

    `orientations` are the allowed axes [rad]. Returns axes (rows, columns) [rad] of a layout that
    succeeds. Returns None if no layout succeeds.

    Raises:
        ValueError: the search needs more than about `most` runs.

    >>> from surface_gym import layouts
    >>> every_layout(Case(layouts.box("S"), speed=0.6)) is None  # no layout sorts box S
    True
    """
    checks.integer("columns", columns, least=1)
    checks.integer("most", most, least=1)
    offered = np.array(checks.orientations("orientations", np.array(orientations)))
    line = case.line(columns, rows)
    one_column = offered[np.array(list(itertools.product(range(len(offered)), repeat=line.rows)))]
    count = len(one_column)
    open_ends = np.full((1, line.rows, columns), layouts.ROLLING)
    done = 0
    for column in range(columns):
        further = []
        share = max(1, AT_ONCE // count)
        for first in range(0, len(open_ends), share):
            own = open_ends[first : first + share]
            axes = np.repeat(own, count, axis=0)
            axes[:, :, column] = np.tile(one_column, (len(own), 1))
            done += len(axes)
            if done > most:
                raise ValueError(f"most must be more than the {done} runs so far, got {most}")
            runs = make_runs(case.speed, case.tilt, layout=np.arange(len(axes)), columns=columns)
            ends = case.run(line, axes, runs)
            # A parcel's motion does not depend on columns that it does not touch.
            final = (ends.touched <= column + 1) | (column + 1 == columns)
            found = np.nonzero(final & case.purpose.succeeds(ends))[0]
            if len(found):
                return axes[found[0]]
            further.append(axes[~final])
        open_ends = np.concatenate(further)
        if not len(open_ends):
            break
    return None


@dataclass(frozen=True, eq=False)
class SortingLayout:
    """A layout that leads a box to y < 0, and the least entry speeds at which the layout works."""

    box: str  # "S" or "B", the study's
    offer: str  # key of `OFFERS`: the allowed orientations
    axis: Array  # (rows, columns) [rad] first row at the smallest y
    least_speed: float  # [m/s] smallest speed from which all of `SPEEDS` succeed
    least_sure_speed: float  # [m/s] the same for 95 % of the draws of unknown quantities
    mean_time: float  # [s] mean time of successful runs
    study_least_speed: float  # [m/s] of the study's layout
    study_least_sure_speed: float  # [m/s]
    study_mean_time: float  # [s]

    @property
    def half_length(self) -> float:
        """[m] half length of the box."""
        return float(layouts.box(self.box).base.outline.max())


@lru_cache(maxsize=1)
def sorting_layouts() -> tuple[SortingLayout, ...]:
    """Load the shipped sorting layouts."""
    text = resources.files("surface_gym.design").joinpath(FILE).read_text("utf-8")
    return tuple(
        SortingLayout(**{**each, "axis": np.radians(each["axis"])}) for each in json.loads(text)
    )


def write_sorting_layouts(
    file: Path = Path(__file__).parent / FILE, offers: Sequence[str] = tuple(OFFERS),
    sizes: Sequence[str] = SIZES, effort: Effort = Effort(), workers: parallel.Workers = 1,
) -> None:  # fmt: skip
    """Repeat the search for the shipped layouts, and write the layouts to a file.

    `offers` are keys of `OFFERS`, which has sets of allowed orientations. `sizes` are boxes, "S" or
    "B". With the default arguments, the search takes six minutes on two cores.
    """
    rows = []
    for offer, size in itertools.product(offers, sizes):
        found = best_layout(
            Case(layouts.box(size), SortPurpose(SIDE)), SPEEDS, COLUMNS,
            orientations=OFFERS[offer], effort=effort, workers=workers,
        )  # fmt: skip
        best, study = found.best, found.study
        rows.append(
            {
                "box": size,
                "offer": offer,
                "axis": np.degrees(best.axis).round(6).tolist(),
                "least_speed": best.least_speed,
                "least_sure_speed": best.least_sure_speed,
                "mean_time": round(best.mean_time, 6),
                "study_least_speed": study.least_speed,
                "study_least_sure_speed": study.least_sure_speed,
                "study_mean_time": round(study.mean_time, 6),
            }
        )
        print(f"{size}-box, {offer}: sorts from {best.least_speed:g} m/s on")
    with files.replacing(file) as part:
        part.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_sorting_layouts(workers=parallel.usable_cores())
