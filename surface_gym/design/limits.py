"""Limits of entry speed, tilt and friction within which a surface fulfils a parcel's purpose.
Draws are random choices of quantities that are unknown in a design, e.g. friction and load.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks, parallel
from surface_gym.design import case as cases, runs
from surface_gym.design.case import NOMINAL, SURE, Case, Draws, Layout, Unknown, is_reliable
from surface_gym.design.columns import MOST, Columns, least_columns
from surface_gym.physics.types import Array, Booleans

# [m/s] and [rad] steps with nothing unknown, and with draws
SPEED_STEPS, TILT_STEPS = (0.01, 0.02), (math.radians(0.1), math.radians(0.2))
FACTOR_RANGE = 16.0  # [-] largest factor of friction to try, and inverse of the smallest
FACTOR_PARTS, FACTOR_PARTS_DRAWN = 48, 8  # factors per doubling with nothing unknown, with draws


class Quantity(NamedTuple):
    """A quantity that is varied to find its limits."""

    name: str  # name of files; for speed and tilt, the field of a case
    description: str
    unit: str
    scale: float  # from SI to `unit`
    question: str  # question answered by its limits, before "be sorted?"


SPEED = Quantity("speed", "entry speed", "m/s", 1.0, "How slow may it come to")
TILT = Quantity("tilt", "tilt", "deg", 180 / math.pi, "How flat may the surface be for it to")


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A case on a line. The first `columns` columns of the zone have a layout for the purpose."""

    case: Case
    line: runs.DesignLine  # has the columns of `least_columns`, so draws are the same
    layout: Layout
    columns: int  # number of turned columns
    chosen: str  # reason for this number

    @property
    def description(self) -> str:
        """Text about the surface, to follow the word "on", e.g. "6 columns of 4 rows, +45 deg"."""
        return (
            f"{cases.plural(self.columns, 'column')} of {self.line.rows} rows, {self.layout.name}"
        )


@dataclass(frozen=True, eq=False)
class Span:
    """Range of a quantity, around the case's own value, in which all tried values succeed."""

    group: str  # group of unknown quantities: `NOMINAL`, a key of `GROUPS`, or `TOGETHER`
    # All tried values from `least` to `most` succeed in all but `WORST` of the draws, including the
    # case's own value. None: the case's own value fails.
    least: float | None
    most: float | None
    values: Array  # (values,) tried values
    share: Array  # (values,) share of successful draws


@dataclass(frozen=True, eq=False)
class Limits(cases.Answer):
    """Limits of one quantity. The purpose succeeds for values between the limits."""

    quantity: Quantity
    own: float  # the case's own value; values are in SI units
    arrangement: Arrangement
    spans: tuple[Span, ...]  # with nothing unknown first, with all quantities unknown last

    @property
    def name(self) -> str:
        return self.quantity.name

    @property
    def sentence(self) -> str:
        arrangement, case = self.arrangement, self.arrangement.case
        known, worst = self.spans[0], self.spans[-1]
        text = (
            f"On {arrangement.description} ({arrangement.chosen}), {self.quantity.description} may "
            f"be {self.describe(known)} for a {case.parcel_text} to {case.purpose.passive}"
        )
        if worst.group != NOMINAL:
            text += f"; {self.describe(worst)} for {SURE} of the draws of unknown quantities"
        first, last = (f"{self.quantity.scale * known.values[k]:.3g}" for k in (0, -1))
        return f"{text}. Tried: {first} to {last} {self.quantity.unit}"

    def describe(self, span: Span) -> str:
        """Return a span as text, e.g. "0.72 to 1.5 m/s" or "0.72 m/s or more"."""
        scale, unit = self.quantity.scale, self.quantity.unit.replace("-", "")
        if span.least is None or span.most is None:
            return f"nothing near {self.own * scale:.4g}"
        low, high = (f"{scale * value:.3g}" for value in (span.least, span.most))
        unit = f" {unit}" if unit else ""
        if span.least == span.values[0] and span.most == span.values[-1]:
            return "anything tried"
        if span.most == span.values[-1]:
            return f"{low}{unit} or more"
        if span.least == span.values[0]:
            return f"{high}{unit} or less"
        return f"{low} to {high}{unit}"

    def tables(self) -> tuple[cases.ReportTable, ...]:
        name, what, unit, *_ = self.quantity
        return _tables(name, what, f"{what} [{unit}]", unit, {(): self})

    def draw(self) -> "cases.Figure":
        """Plot the success rate over the quantity, one curve per group of unknown quantities."""
        case, quantity = self.arrangement.case, self.quantity
        figure, axes = cases.new_panel(
            f"{quantity.question} {case.purpose.passive}?",
            f"{case.parcel_text}; {self.arrangement.description}",
        )
        self.draw_curves(axes)
        own = quantity.scale * self.own
        axes.set(xlabel=f"{quantity.description} [{quantity.unit}]", ylabel="success")
        axes.axvline(own, color="black", linewidth=0.8, linestyle=":")
        axes.annotate(
            f" {case.entry_text}", (own, 0.02), fontsize="small", rotation=90.0,
            ha="left", va="bottom", bbox={"color": "white", "alpha": 0.7, "pad": 0.5},
        )  # fmt: skip
        axes.legend(**cases.legend_of_drawn(axes))
        return figure

    def draw_curves(self, axes: "cases.Axes") -> None:
        from matplotlib.ticker import PercentFormatter

        for span in self.spans:
            colour, style = cases.LINES[span.group]
            values = self.quantity.scale * span.values
            if span.group == NOMINAL:
                axes.fill_between(
                    values, span.share, step="mid", color=colour, alpha=0.25, linewidth=0.0,
                    label="nothing unknown",
                )  # fmt: skip
                continue
            axes.plot(
                values, span.share, color=colour, linestyle=style,
                linewidth=2.2 if span.group == cases.TOGETHER else 1.5,
                label=cases.group_label(span.group),
            )  # fmt: skip
        axes.axhline(1.0 - cases.WORST, color=cases.ORANGE, linewidth=0.8)
        axes.grid(alpha=0.25)
        axes.set_ylim(0.0, 1.03)
        axes.margins(x=0.0)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))


@dataclass(frozen=True, eq=False)
class FrictionRange(cases.Answer):
    """Limits of mu_max and mu_min in multiples of the case's values. One value varies at a time."""

    along: Limits  # factors of mu_max
    across: Limits  # factors of mu_min

    name = "friction"

    @property
    def sentence(self) -> str:
        arrangement, case = self.along.arrangement, self.along.arrangement.case
        both = ((self.along, "mu_max", case.mu_max), (self.across, "mu_min", case.mu_min))
        own = " and ".join(
            f"{name} / {mu:g} may be {limits.describe(limits.spans[0])}"
            for limits, name, mu in both
        )
        text = (
            f"On {arrangement.description} ({arrangement.chosen}), for a {case.parcel_text} "
            f"that comes {case.entry_text} to {case.purpose.passive}, {own}"
        )
        if self.along.spans[-1].group != NOMINAL:
            worst = (
                f"{name} / {mu:g} {limits.describe(limits.spans[-1])}" for limits, name, mu in both
            )
            text += f"; for {SURE} of the draws of other unknown quantities, {' and '.join(worst)}"
        return f"{text}. Tried: 1/{FACTOR_RANGE:g} to {FACTOR_RANGE:g} times"

    def tables(self) -> tuple[cases.ReportTable, ...]:
        both = (self.along, self.across)
        parts: dict[tuple[str, ...], Limits] = {(x.quantity.description,): x for x in both}
        return _tables("friction", "friction", "factor [-]", "-", parts)

    def draw(self) -> "cases.Figure":
        """Plot the success rate over the factor of mu_max, and over the factor of mu_min."""
        from matplotlib.ticker import FuncFormatter

        arrangement, case = self.along.arrangement, self.along.arrangement.case
        title = f"How far may friction be off for it to {case.purpose.passive}?"
        subtitle = f"{case.parcel_text}; {arrangement.description}"
        figure = cases.new_figure(9.6, 4.4, f"{title}\n{subtitle}", "medium")
        panels = figure.subplots(1, 2, sharey=True)
        along = (self.along, f"along axes, mu_max, over {case.mu_max:g}")
        across = (self.across, f"across axes, mu_min, over {case.mu_min:g}")
        for axes, (limits, name) in zip(panels, (along, across), strict=True):
            limits.draw_curves(axes)
            axes.set_xscale("log", base=2)
            axes.xaxis.set_major_formatter(
                FuncFormatter(lambda value, _: f"{value:g}" if value >= 1.0 else f"1/{1 / value:g}")
            )
            axes.axvline(1.0, color="black", linewidth=0.8, linestyle=":")
            axes.set_xlabel(f"friction {name}")
        panels[0].set_ylabel("success")
        panels[1].legend(**cases.legend_of_drawn(panels[1]))
        return figure


def _tables(
    name: str, what: str, value: str, unit: str, parts: dict[tuple[str, ...], Limits]
) -> tuple[cases.ReportTable, ...]:
    """Make a table of limits, one row per `Span`, and a table of success, one row per tried value.

    Args:
        name: file name of the table of limits.
        what: name of the quantity in titles.
        value: heading of the column with tried values.
        unit: unit of the limits in headings.
        parts: limits of each varied quantity. A key is a tuple with the quantity's name. The
            table has a column for this name, unless the key is the empty tuple.
    """
    limits, curve = [], []
    for varied, each in parts.items():
        scale = each.quantity.scale
        for span in each.spans:
            label = (*varied, cases.group_label(span.group))
            ends = [None if end is None else scale * end for end in (span.least, span.most)]
            own = float(span.share[abs(span.values - each.own).argmin()])
            limits.append((*label, *ends, own))
            points = zip(span.values.tolist(), span.share.tolist(), strict=True)
            curve += [(*label, scale * x, share) for x, share in points]
    single = () in parts
    title = f"Limits of {what}" + ("" if single else ", as factors")
    head = ("unknown",) if single else ("varied", "unknown")
    ends_head = (f"least [{unit}]", f"most [{unit}]", "success as it comes")
    return (
        cases.ReportTable(name, title, (*head, *ends_head), tuple(limits)),
        cases.ReportTable(
            f"{name}_curve", f"Success by {what}", (*head, value, "success"), tuple(curve),
            shown=False,
        ),
    )  # fmt: skip


def least_speed(
    case: Case, columns: int | None = None, rows: int | None = None, highest: float | None = None,
    workers: parallel.Workers = 1, on_progress: runs.OnProgress = lambda *_: None,
) -> Limits:  # fmt: skip
    """Find the smallest and the largest entry speed with success, at the case's tilt.

    The tried speeds include the case's speed, and end at `highest` [m/s]. The step is 0.01 m/s
    without unknown quantities, and 0.02 m/s with draws. The default of `highest` is 1.5 times the
    case's speed, but at least 3 m/s and at most 20 m/s. For `columns`, `rows` and `workers` see
    `arrange`.

    >>> from surface_gym import layouts
    >>> from surface_gym.design.case import NOTHING
    >>> case = Case(layouts.box("S"), speed=1.2, unknown=NOTHING)
    >>> least_speed(case).spans[0].least  # as in the study
    0.72
    """
    top = min(20.0, max(3.0, 1.5 * case.speed)) if highest is None else highest
    checks.within("highest", top, max(case.speed, SPEED_STEPS[1]), 20.0)
    return _sweep(case, SPEED, SPEED_STEPS, top, columns, rows, workers, on_progress)


def least_tilt(
    case: Case, columns: int | None = None, rows: int | None = None, highest: float | None = None,
    workers: parallel.Workers = 1, on_progress: runs.OnProgress = lambda *_: None,
) -> Limits:  # fmt: skip
    """Find the smallest and the largest tilt with success, at the case's entry speed.

    Tries the case's tilt and multiples of a step up to `highest` [rad]. The step is 0.1 deg if all
    quantities are known, else 0.2 deg. The default of `highest` is the greater of 15 deg and 1.5
    times the case's tilt, but at most 44 deg. For `columns`, `rows` and `workers` see `arrange`.
    """
    usual = max(math.radians(15.0), 1.5 * case.tilt)
    top = max(case.tilt, min(math.radians(44.0), usual)) if highest is None else highest
    if not max(case.tilt, TILT_STEPS[1]) <= checks.number("highest", top) < math.pi / 4:
        raise ValueError(
            f"highest must be from the case's tilt, {case.tilt:g}, to below pi/4 (45 deg), "
            f"got {top!r}; {checks.DEGREES}"
        )
    return _sweep(case, TILT, TILT_STEPS, top, columns, rows, workers, on_progress)


def friction_range(
    case: Case, columns: int | None = None, rows: int | None = None,
    workers: parallel.Workers = 1, on_progress: runs.OnProgress = lambda *_: None,
) -> FrictionRange:  # fmt: skip
    """Find the limits of a factor of mu_max (along axes) and of a factor of mu_min (across axes).

    Factors are from 1/16 to 16. All rotors have the same factor. If nothing is unknown, 48 factors
    per doubling are tried. If a quantity is unknown, 8 factors per doubling are tried. Friction
    does not count as an unknown quantity here. For other arguments see `arrange`.
    """
    arrangement = arrange(case, columns, rows, workers)
    unknown = replace(case.unknown, friction=0.0, rolling=0.0)
    octaves = round(math.log2(FACTOR_RANGE))
    grids = [
        2.0 ** (np.arange(-octaves * parts, octaves * parts + 1) / parts)
        for parts in (FACTOR_PARTS, FACTOR_PARTS_DRAWN)
    ]

    def limits(place: int, name: str) -> Limits:
        question = f"How far may {name} be off for it to"
        quantity = Quantity(f"friction_{name}", f"factor on {name}", "-", 1.0, question)

        def at(values: Array) -> runs.RunRequests:
            friction = np.ones((len(values), 3))
            friction[:, place] = values
            return runs.make_runs(np.full(len(values), case.speed), case.tilt, friction=friction)

        def half(done: int, total: int) -> None:
            on_progress(place * total + done, 2 * total)

        return _limits(arrangement, quantity, 1.0, grids, unknown, at, workers, half)

    return FrictionRange(limits(0, "mu_max"), limits(1, "mu_min"))


def span_around(done: Booleans, own: int) -> tuple[int, int] | None:
    """Return first and last index of successes around index `own`, or None if `own` fails."""
    if not done[own]:
        return None
    fails = np.nonzero(~done)[0]
    below, above = fails[fails < own], fails[fails > own]
    first = int(below[-1]) + 1 if len(below) else 0
    last = int(above[0]) - 1 if len(above) else len(done) - 1
    return first, last


def _sweep(
    case: Case, quantity: Quantity, steps: tuple[float, float], top: float, columns: int | None,
    rows: int | None, workers: parallel.Workers, on_progress: runs.OnProgress,
) -> Limits:  # fmt: skip
    """Find the limits of the case's speed or tilt. All other quantities stay as in the case.

    The search tests the case's own value, and the multiples of a step. The greatest tested
    multiple is about `top`. The step is `steps[0]` if all quantities are known, else `steps[1]`.
    """
    arrangement = arrange(case, columns, rows, workers)
    own = getattr(case, quantity.name)
    # At rest on a level surface, success is impossible.
    least = 0 if (case.tilt if quantity is SPEED else case.speed) else 1
    grids = []
    for step in steps:
        multiples = step * np.arange(least, round(top / step) + 1)
        apart = np.abs(multiples - own) > 0.01 * step
        grids.append(np.unique(np.append(multiples[apart].round(9), own)))

    def at(values: Array) -> runs.RunRequests:
        swept: dict[str, Any] = {"speed": case.speed, "tilt": case.tilt, quantity.name: values}
        return runs.make_runs(**swept)

    return _limits(arrangement, quantity, own, grids, case.unknown, at, workers, on_progress)


def _limits(
    arrangement: Arrangement, quantity: Quantity, own: float, grids: list[Array], unknown: Unknown,
    at: Callable[[Array], runs.RunRequests], workers: parallel.Workers,
    on_progress: runs.OnProgress,
) -> Limits:  # fmt: skip
    """Find the range of successful values around `own`, for each group of unknown quantities.

    The function `at` returns the runs for values (points,) of the quantity. If nothing is unknown,
    the values in `grids[0]` are tried. If a group is unknown, the values in `grids[1]` are tried.
    """
    groups = {
        name: arrangement.case.draw(arrangement.line, each)
        for name, each in unknown.by_group().items()
    }
    values = [grids[0 if group == NOMINAL else 1] for group in groups]
    counts = [len(tried) * len(drawn) for tried, drawn in zip(values, groups.values(), strict=True)]
    progress = runs.split_progress(on_progress, counts)
    spans = []
    for (group, drawn), tried, part in zip(groups.items(), values, progress, strict=True):
        share = success_shares(arrangement, drawn, at(tried), workers, part)
        ends = span_around(is_reliable(share), int(np.abs(tried - own).argmin()))
        least, most = (None, None) if ends is None else (float(tried[k]) for k in ends)
        spans.append(Span(group, least, most, tried, share))
    return Limits(quantity, own, arrangement, tuple(spans))


def arrange(
    case: Case, columns: int | None = None, rows: int | None = None,
    workers: parallel.Workers = 1,
) -> Arrangement:  # fmt: skip
    """Choose a line for a case, and the study's layout that succeeds most often on this line.

    The default of `columns` is the smallest number that suffices for 95 % of the draws of all
    unknown quantities. If no number suffices for these draws, the default is the smallest number
    that suffices for nominal quantities. The function `line_for` chooses the default of `rows`.
    `workers` is either a number of threads or a cluster.
    """
    parallel.check_workers(workers)
    chosen = "as asked"
    if columns is None:
        columns, chosen = _fewest(case, least_columns(case, rows, workers=workers))
    line = case.line(max(MOST, checks.integer("columns", columns, least=1)), rows)
    layouts = case.purpose.layouts(line, columns)
    tried = [Arrangement(case, line, layout, columns, chosen) for layout in layouts]
    point = runs.make_runs(case.speed, case.tilt)

    def merit(each: Arrangement) -> list[float]:
        """Return success (0 or 1) with nominal quantities, and the success rate over draws."""
        return [
            float(success_shares(each, case.draw(line, unknown), point, workers)[0])
            for unknown in (cases.NOTHING, case.unknown)
        ]

    return max(tried, key=merit) if len(tried) > 1 else tried[0]


def success_shares(
    arrangement: Arrangement, drawn: Draws, points: runs.RunRequests,
    workers: parallel.Workers = 1, on_progress: runs.OnProgress = lambda *_: None,
) -> Array:  # fmt: skip
    """Return the share of successful draws at each point, shape (points,).

    A point is a row of `points`. Only speed, tilt and friction of the points are used. All points
    have the same draws.
    """
    case, line = arrangement.case, arrangement.line
    speed, tilt, factors = (
        values[:, np.newaxis] for values in (points.speed, points.tilt, points.friction)
    )
    # A run ends after the zone, plus a run-out if it may help.
    passed = arrangement.columns + (0 if case.purpose.leaves_zone else line.run_out)
    asked = drawn.runs(speed, tilt, passed, friction=factors)
    axes = arrangement.layout.axis[np.newaxis]
    done = case.purpose.succeeds(case.run(line, axes, asked, drawn, workers, on_progress))
    return done.reshape(len(points), len(drawn)).mean(axis=1)


def _fewest(case: Case, found: Columns) -> tuple[int, str]:
    """Return `arrange`'s default number of columns, and a text with the reason for this number.

    Raise a ValueError if no number of columns in `found` suffices.
    """
    if found.together is not None and found.together.columns is not None:
        return found.together.columns, f"the fewest for {SURE} of the draws"
    if found.columns is None:
        raise ValueError(
            f"columns must be given: by the study's layouts no number up to {MOST} does it "
            f"at {case.speed:g} m/s"
        )
    if not found.worst:
        return found.columns, "the fewest, with nothing unknown"
    return found.columns, f"the fewest with nothing unknown; none do for {SURE} of draws"
