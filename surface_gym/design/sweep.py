"""Success of one surface over unknown quantities, entry speeds and sizes of a parcel."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from surface_gym import checks, parallel
from surface_gym.design import case as cases, report, runs as running
from surface_gym.design.columns import MOST, Columns, least_columns
from surface_gym.design.runs import DesignLine, OnProgress
from surface_gym.parcel import Parcel
from surface_gym.physics.types import Array, Booleans


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A case on a line whose first columns are turned by one of the purpose's layouts."""

    case: cases.Case
    line: DesignLine  # with as many columns as `least_columns` tries, so that draws are the same
    layout: cases.Layout
    columns: int  # that are turned
    chosen: str  # reason for their number

    @property
    def description(self) -> str:
        """The surface as it follows "on": "6 columns of 4 rows, +45 deg"."""
        return (
            f"{report.plural(self.columns, 'column')} of {self.line.rows} rows, {self.layout.name}"
        )

    @property
    def passed(self) -> int:
        """Columns behind which a run ends: of the zone, and of a run-out where it may help."""
        return self.columns + (0 if self.case.purpose.leaves_zone else self.line.run_out)

    def run(
        self,
        drawn: cases.Draws,
        runs: running.Runs,
        workers: parallel.Workers = 1,
        on_progress: OnProgress = lambda *_: None,
    ) -> running.Ends:
        """Simulate runs of draws over the layout."""
        axes = self.layout.axis[np.newaxis]
        return self.case.run(self.line, axes, runs, drawn, workers, on_progress)


def arrange(
    case: cases.Case,
    columns: int | None = None,
    rows: int | None = None,
    workers: parallel.Workers = 1,
) -> Arrangement:
    """Choose the surface on which a case is swept, with the layout that succeeds in most draws.

    Without `columns` it has the fewest for all but `WORST` of the draws of all unknown quantities;
    if no number is enough, the fewest with nothing unknown.
    """
    parallel.check_workers(workers)
    chosen = "as asked"
    if columns is None:
        columns, chosen = _fewest(case, least_columns(case, rows, workers=workers))
    line = case.line(max(MOST, checks.integer("columns", columns, least=1)), rows)
    tried = [
        Arrangement(case, line, layout, columns, chosen)
        for layout in case.purpose.layouts(line, columns)
    ]
    if len(tried) == 1:
        return tried[0]
    point = running.make_runs(case.speed, case.tilt)

    def merit(each: Arrangement) -> tuple[float, ...]:
        """Return the success with nothing unknown, and the share of the draws that succeed."""
        return tuple(
            float(success_shares(each, case.draw(line, unknown), point, workers)[0])
            for unknown in (cases.NOTHING, case.unknown)
        )

    return max(tried, key=merit)


def success_shares(
    arrangement: Arrangement,
    drawn: cases.Draws,
    points: running.Runs,
    workers: parallel.Workers = 1,
    on_progress: OnProgress = lambda *_: None,
) -> Array:
    """Return the share (points,) of the draws that succeed, with the same draws at every point.

    Of the points, speed, tilt and friction count.
    """
    speed, tilt, factors = (
        values[:, np.newaxis] for values in (points.speed, points.tilt, points.friction)
    )
    runs = drawn.runs(speed, tilt, arrangement.passed, friction=factors)
    ends = arrangement.run(drawn, runs, workers, on_progress)
    done = arrangement.case.purpose.succeeds(ends)
    return done.reshape(len(points), len(drawn)).mean(axis=1)


def _fewest(case: cases.Case, found: Columns) -> tuple[int, str]:
    """Return the number of columns to take, and the reason for it."""
    if found.together is not None and found.together.columns is not None:
        return found.together.columns, f"the fewest for {cases.SURE} of the draws"
    if found.columns is None:
        raise ValueError(
            f"columns must be given: by the study's layouts no number up to {MOST} does it "
            f"at {case.speed:g} m/s"
        )
    if not found.worst:
        return found.columns, "the fewest, with nothing unknown"
    return found.columns, f"the fewest with nothing unknown; none do for {cases.SURE} of draws"


# Spreads that a field is drawn with where the case's own is 0.
USUAL = cases.Unknown(
    friction=0.2, rolling=0.2, mass=0.1, com_offset=0.1, stiffness=0.35, lateral=0.01,
    heading=math.radians(2.0), speed=0.05, tilt=math.radians(0.2),
)  # fmt: skip
# Fields of `Unknown`: label, scale and unit of the spread.
FIELDS = {
    "friction": ("friction along axes", 100.0, " %"),
    "rolling": ("friction across axes", 100.0, " %"),
    "com_offset": ("centre of mass", 100.0, " %"),
    "mass": ("mass at its inertia", 100.0, " %"),
    "stiffness": ("unevenness", 1.0, ""),
    "lateral": ("place across", 1000.0, " mm"),
    "heading": ("heading", 180.0 / math.pi, " deg"),
    "speed": ("entry speed", 1.0, " m/s"),
    "tilt": ("tilt", 180.0 / math.pi, " deg"),
}


@dataclass(frozen=True)
class Bar:
    """The effect of one unknown quantity."""

    field: str  # of `Unknown`
    spread: float  # it was drawn with, in the field's unit
    usual: bool  # whether that is `USUAL`'s, as the case's own is 0
    # `WORST` and 1 - `WORST` quantile of the purpose's measure, in SI units, among the draws that
    # have one; nan: none has
    low: float
    high: float
    success: float  # [-] share of the draws that succeed

    @property
    def label(self) -> str:
        """The quantity and its spread: "heading +-2 deg"."""
        name, scale, unit = FIELDS[self.field]
        return f"{name} +-{scale * self.spread:.3g}{unit}"


@dataclass(frozen=True)
class Sensitivity(report.Answer):
    """The effect of each unknown quantity alone, on one surface."""

    arrangement: Arrangement
    measure: float  # with nothing unknown, in SI units; nan: none
    success: bool  # with nothing unknown
    bars: tuple[Bar, ...]  # in the order of `FIELDS`

    name = "sensitivity"

    @property
    def sentence(self) -> str:
        case = self.arrangement.case
        purpose = case.purpose
        asked = f"On {self.arrangement.description}, to {purpose.action} {case.entry_text}"
        spread = [bar for bar in self.bars if not math.isnan(bar.high - bar.low)]
        if not spread:
            return f"{asked}, no draw comes as far as a measure"
        widest = max(spread, key=lambda bar: bar.high - bar.low)
        worst = min(self.bars, key=lambda bar: bar.success)
        low, high = (f"{purpose.scale * value:.3g}" for value in (widest.low, widest.high))
        unit = f" {purpose.unit}" if purpose.unit != "-" else ""
        success = (
            f"success suffers most from {worst.label}, {worst.success:.0%}"
            if worst.success < 1.0
            else "all succeed"
        )
        return (
            f"{asked}, {purpose.measured} is spread most by {widest.label}: {low} to {high}{unit} "
            f"in nine draws of ten; {success}"
        )

    def tables(self) -> tuple[report.Table, ...]:
        purpose = self.arrangement.case.purpose
        known = purpose.scale * self.measure
        quantiles = [f"{share:.0%} of draws below" for share in (cases.WORST, 1.0 - cases.WORST)]
        first: tuple[report.Cell, ...] = ("nothing", known, known, float(self.success), "")
        rows = [
            (
                bar.label,
                purpose.scale * bar.low,
                purpose.scale * bar.high,
                bar.success,
                "usual" if bar.usual else "the case's",
            )
            for bar in self.bars
        ]
        title = f"{purpose.measured.capitalize()} [{purpose.unit}]"
        header = ("unknown alone", *quantiles, "success", "spread is")
        return (report.Table("sensitivity", title, header, (first, *rows)),)

    def draw(self) -> "report.Figure":
        """Draw a bar for each quantity, from `WORST` to 1 - `WORST` of the draws' measures."""
        case = self.arrangement.case
        purpose = case.purpose
        figure, axes = report.new_panel(
            f"What matters most for it to {purpose.passive}?",
            f"{case.parcel_text} {case.entry_text}; {self.arrangement.description}",
        )
        bars = sorted(
            self.bars, key=lambda bar: -1.0 if math.isnan(bar.high) else bar.high - bar.low
        )
        for k, bar in enumerate(bars):
            if math.isnan(bar.low):
                continue
            ends = purpose.scale * bar.low, purpose.scale * bar.high
            axes.barh(
                k, ends[1] - ends[0], left=ends[0], color=report.BLUE,
                alpha=0.45 if bar.usual else 1.0, height=0.6,
            )  # fmt: skip
            axes.plot(ends, (k, k), "|", color=report.BLUE, markersize=11)
        if not math.isnan(self.measure):
            axes.axvline(purpose.scale * self.measure, color="black", linewidth=1.2)
        axes.set_yticks(range(len(bars)), [bar.label for bar in bars])
        right = axes.secondary_yaxis("right")
        right.set_yticks(range(len(bars)), [f"{bar.success:.0%}" for bar in bars])
        right.set_ylabel("success")
        axes.set_ylim(-0.6, len(bars) - 0.4)
        axes.margins(x=0.05)
        axes.use_sticky_edges = False
        axes.set_xlabel(
            f"{purpose.measured} [{purpose.unit}]; line: nothing unknown\n"
            f"bars: {cases.WORST:.0%} to {cases.SURE} of the draws, each alone; "
            "pale: a usual spread, the case has none",
            fontsize="small",
        )
        return figure


def sensitivity(
    case: cases.Case,
    columns: int | None = None,
    rows: int | None = None,
    workers: parallel.Workers = 1,
    on_progress: OnProgress = lambda *_: None,
) -> Sensitivity:
    """Find the effect of each field of `Unknown` alone, on the purpose's measure and on success.

    A field whose spread is 0 in the case is drawn with a usual one, `USUAL`, and marked so.
    """
    arrangement = arrange(case, columns, rows, workers)
    progress = running.split_progress(on_progress, [1] + [case.draws] * len(FIELDS))

    def results(unknown: cases.Unknown, part: OnProgress) -> tuple[Array, Booleans]:
        """Return the purpose's measure (draws,) of each draw, and its success."""
        drawn = case.draw(arrangement.line, unknown)
        runs = drawn.runs(case.speed, case.tilt, arrangement.passed)
        ends = arrangement.run(drawn, runs, workers, part)
        return case.purpose.measure(ends), case.purpose.succeeds(ends)

    measure, success = results(cases.NOTHING, progress[0])
    bars = []
    for name, part in zip(FIELDS, progress[1:], strict=True):
        own = getattr(case.unknown, name)
        spread = own or getattr(USUAL, name)
        found, done = results(replace(cases.NOTHING, **{name: spread}), part)
        there = found[~np.isnan(found)]
        low, high = (
            np.quantile(there, (cases.WORST, 1.0 - cases.WORST))
            if len(there)
            else (math.nan, math.nan)
        )
        bars.append(Bar(name, spread, not own, float(low), float(high), float(done.mean())))
    return Sensitivity(arrangement, float(measure[0]), bool(success[0]), tuple(bars))


SHOWN = 11  # sizes that a terminal shows


@dataclass(frozen=True, eq=False)
class SuccessMap(report.Answer):
    """Success over entry speeds and sizes."""

    speeds: Array  # (speeds,) [m/s]
    sizes: Array  # (sizes,) [-] lengths of the base over the case's
    nominal: Booleans  # (sizes, speeds) success with nothing unknown
    share: Array  # (sizes, speeds) of the draws that succeed
    arrangement: Arrangement

    name = "map"

    @property
    def sentence(self) -> str:
        sure = cases.is_reliable(self.share)
        best = int(sure.sum(axis=1).argmax())
        parcel = self.arrangement.case.parcel_text
        asked = f"On {self.arrangement.description}, made for a {parcel}"
        speeds = self.speeds[sure[best]]
        if len(speeds) == 0:
            return f"{asked}, no speed and size here do it in {cases.SURE} of the draws"
        return (
            f"{asked}, {float(sure.mean()):.0%} of these speeds and sizes do it in {cases.SURE} of "
            f"the draws; most for {self.sizes[best]:.2g} times its size, within {speeds[0]:.3g} to "
            f"{speeds[-1]:.3g} m/s"
        )

    def tables(self) -> tuple[report.Table, ...]:
        places = sorted({round(k * (len(self.sizes) - 1) / (SHOWN - 1)) for k in range(SHOWN)})
        rows: list[tuple[report.Cell, ...]] = []
        for k in places:
            speeds = self.speeds[cases.is_reliable(self.share[k])]
            ends = (speeds[0], speeds[-1]) if len(speeds) else (math.nan, math.nan)
            rows.append((float(self.sizes[k]), *map(float, ends), float(self.share[k].mean())))
        cells = tuple(
            (size, speed, bool(self.nominal[k, i]), float(self.share[k, i]))
            for k, size in enumerate(self.sizes.tolist())
            for i, speed in enumerate(self.speeds.tolist())
        )
        return (
            report.Table(
                "map_sizes",
                f"Least and most entry speed that does it in {cases.SURE} of draws",
                ("size [-]", "least [m/s]", "most [m/s]", "success over all speeds"),
                tuple(rows),
                written=False,
            ),
            report.Table(
                "map",
                "Success by size and speed",
                ("size [-]", "speed [m/s]", "nothing unknown", "success"),
                cells,
                shown=False,
            ),
        )

    def draw(self) -> "report.Figure":
        """Draw success over entry speed and size."""
        case = self.arrangement.case
        figure, axes = report.new_panel(
            f"Which speeds and sizes can {case.purpose.passive}?",
            f"{case.parcel_text} at size 1; {self.arrangement.description}",
        )
        image = axes.pcolormesh(
            self.speeds, self.sizes, 100.0 * self.share, cmap="cividis", vmin=0.0, vmax=100.0,
            shading="nearest", rasterized=True,
        )  # fmt: skip
        figure.colorbar(image, ax=axes, label="success [% of the draws]")
        if min(self.share.shape) > 1:
            for values, level, style, colour in (
                (self.share, 1.0 - cases.WORST, "-", "black"),
                (self.nominal.astype(float), 0.5, "--", "white"),
            ):
                if values.min() < level < values.max():
                    axes.contour(
                        self.speeds, self.sizes, values, [level], colors=colour, linestyles=style,
                        linewidths=1.5,
                    )  # fmt: skip
        axes.plot([], [], color="black", label=f"{cases.SURE} of the draws")
        axes.plot([], [], color="white", linestyle="--", label="nothing unknown")
        axes.plot(case.speed, 1.0, "*", color="white", markeredgecolor="black", markersize=13,
                  label="as it comes")  # fmt: skip
        axes.set(xlabel="entry speed [m/s]", ylabel="size of the parcel over the case's [-]")
        axes.grid(False)
        legend = axes.legend(loc="upper right", fontsize="small", framealpha=0.9)
        legend.get_frame().set_facecolor("#b0b0b0")
        return figure


def success_map(
    case: cases.Case, columns: int | None = None, speeds: Sequence[float] | None = None,
    sizes: Sequence[float] | None = None, rows: int | None = None, workers: parallel.Workers = 1,
    checkpoint: Path | str | None = None, on_progress: OnProgress = lambda *_: None,
) -> SuccessMap:  # fmt: skip
    """Find the share of draws that succeed, over entry speeds and sizes, on one surface.

    The zone is the one for the case's parcel. Each size starts wholly on a lead-in of its own
    length; mass stays, inertia goes with the square of the size. The draws are the same in each
    cell, down to the elements of the zone.

    Args:
        case: the parcel, its entry and its purpose.
        columns: of the zone; None: the fewest that all but 5 % of the draws need.
        speeds: [m/s] at entry; None: 40 from 0.1 to 3, or to half as much again as the case's.
        sizes: [-] factors on the base's lengths; None: 40 from 0.5 to 1.5.
        rows: of rotors; None: as many as lie under the case's parcel.
        workers: threads that share the runs, or a cluster.
        checkpoint: file that keeps the finished sizes; a map whose file exists is resumed.
        on_progress: called with the runs done and their total.

    Raises:
        ValueError: speeds or sizes that do not rise, a speed that is not from 0 to 20, a size that
            is not positive or too large, a checkpoint of another map or none at all, or no columns
            are enough.
    """
    wanted_speeds = np.linspace(0.1, max(3.0, 1.5 * case.speed), 40) if speeds is None else speeds
    wanted_sizes = np.linspace(0.5, 1.5, 40) if sizes is None else sizes
    over = checks.array("speeds", wanted_speeds, (None,))
    factors = checks.array("sizes", wanted_sizes, (None,))
    for name, values in (("speeds", over), ("sizes", factors)):
        if len(values) == 0:
            raise ValueError(f"{name} must be at least one, got none")
        if (np.diff(values) <= 0.0).any():
            raise ValueError(f"{name} must rise, got {values[0]:g} to {values[-1]:g}")
    for speed in over.tolist():
        checks.within("speeds", speed, 0.0, 20.0)
    for size in factors.tolist():
        checks.positive("sizes", size, *checks.LENGTH)
    arrangement = arrange(case, columns, rows, workers)
    file = None if checkpoint is None else Path(checkpoint)
    identity = case.identity(
        columns=arrangement.columns, rows=arrangement.line.rows, speeds=over.tolist(),
        sizes=factors.tolist(),
    )  # fmt: skip
    found = np.full((2, len(factors), len(over)), math.nan)
    if file is not None and file.exists():
        kept = cases.load_checkpoint(file, "map", identity, ("found",))["found"]
        done = kept[~np.isnan(kept)] if kept.dtype == found.dtype else np.full(1, math.nan)
        if kept.shape != found.shape or not ((done >= 0.0) & (done <= 1.0)).all():
            raise ValueError(
                f"checkpoint must be one of a map, got {file}: found must be shares of the shape "
                f"{found.shape}, got {kept.dtype} of {kept.shape}"
            )
        found = kept
    largest = _scaled(case.parcel, float(factors.max()))
    whole = _line_for_size(arrangement.line, case, largest)
    whole.check_capacity(largest.base, whole.shape[::-1])
    groups = list(case.unknown.by_group().values())
    drawn = [case.draw(whole, unknown) for unknown in (groups[0], groups[-1])]
    counts = [len(over) * len(each) for each in drawn]
    progress = running.split_progress(on_progress, counts * len(factors))
    points = running.make_runs(over, case.tilt)
    for row, size in enumerate(factors.tolist()):
        if not np.isnan(found[0, row, 0]):
            continue
        parcel = _scaled(case.parcel, size)
        line = replace(whole, lead_in=_line_for_size(arrangement.line, case, parcel).lead_in)
        own = replace(arrangement, case=replace(case, parcel=parcel), line=line)
        for k, each in enumerate(drawn):
            scaled = _scaled_draws(each, size, whole.lead_in - line.lead_in)
            part = progress[len(drawn) * row + k]
            found[k, row] = success_shares(own, scaled, points, workers, part)
        if file is not None:
            cases.save_checkpoint(file, identity, {"found": found})
    on_progress(sum(counts) * len(factors), sum(counts) * len(factors))
    return SuccessMap(over, factors, found[0] > 0.5, found[1], arrangement)


def _scaled_draws(drawn: cases.Draws, size: float, columns: int) -> cases.Draws:
    """Return the draws for parcels of another size, on a line with fewer columns in its lead-in."""
    return replace(
        drawn,
        parcels=tuple(_scaled(parcel, size) for parcel in drawn.parcels),
        stiffness=None if drawn.stiffness is None else drawn.stiffness[:, :, columns:],
    )


def _scaled(parcel: Parcel, size: float) -> Parcel:
    """Return the parcel with each length of its base times a factor."""
    x, y = parcel.com_offset
    return replace(
        parcel,
        base=parcel.base.scaled(size),
        inertia=parcel.moment_of_inertia * size**2,
        com_offset=(size * x, size * y),
    )


def _line_for_size(line: DesignLine, case: cases.Case, parcel: Parcel) -> DesignLine:
    """Return the case's line with a lead-in, a run-out and supports for another parcel."""
    own = running.line_for(parcel, line.columns, line.rows, case.pitch)
    return replace(line, lead_in=own.lead_in, run_out=own.run_out, beside=own.beside)
