"""The success of one surface over entry speeds and sizes of a parcel."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design import report
from surface_gym.design.case import (
    SURE,
    WORST,
    Case,
    Draws,
    is_reliable,
    load_checkpoint,
    save_checkpoint,
)
from surface_gym.design.line import DesignLine, line_for
from surface_gym.design.runs import OnProgress, split_progress
from surface_gym.design.sensitivity import Arrangement, arrange, repeat_case, success_shares
from surface_gym.parallel import Workers
from surface_gym.parcel import Parcel
from surface_gym.physics.types import check_capacity

SHOWN = 11  # sizes that a terminal shows

Booleans = NDArray[np.bool_]
Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SuccessMap(report.Answer):
    """Success over entry speeds and sizes."""

    speeds: Numbers  # (speeds,) [m/s]
    sizes: Numbers  # (sizes,) [-] lengths of the base over the case's
    nominal: Booleans  # (sizes, speeds) success with nothing unknown
    share: Numbers  # (sizes, speeds) of the draws that succeed
    arrangement: Arrangement

    name = "map"

    @property
    def sentence(self) -> str:
        sure = is_reliable(self.share)
        best = int(sure.sum(axis=1).argmax())
        parcel = self.arrangement.case.parcel_text
        asked = f"On {self.arrangement.description}, made for a {parcel}"
        speeds = self.speeds[sure[best]]
        if len(speeds) == 0:
            return f"{asked}, no speed and size here do it in {SURE} of the draws"
        return (
            f"{asked}, {float(sure.mean()):.0%} of these speeds and sizes do it in {SURE} of the "
            f"draws; most for {self.sizes[best]:.2g} times its size, within {speeds[0]:.3g} to "
            f"{speeds[-1]:.3g} m/s"
        )

    def tables(self) -> tuple[report.Table, ...]:
        places = sorted({round(k * (len(self.sizes) - 1) / (SHOWN - 1)) for k in range(SHOWN)})
        rows: list[tuple[report.Cell, ...]] = []
        for k in places:
            speeds = self.speeds[is_reliable(self.share[k])]
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
                f"Least and most entry speed that does it in {SURE} of draws",
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
                (self.share, 1.0 - WORST, "-", "black"),
                (self.nominal.astype(float), 0.5, "--", "white"),
            ):
                if values.min() < level < values.max():
                    axes.contour(
                        self.speeds, self.sizes, values, [level], colors=colour, linestyles=style,
                        linewidths=1.5,
                    )  # fmt: skip
        axes.plot([], [], color="black", label=f"{SURE} of the draws")
        axes.plot([], [], color="white", linestyle="--", label="nothing unknown")
        axes.plot(case.speed, 1.0, "*", color="white", markeredgecolor="black", markersize=13,
                  label="as it comes")  # fmt: skip
        axes.set(xlabel="entry speed [m/s]", ylabel="size of the parcel over the case's [-]")
        axes.grid(False)
        legend = axes.legend(loc="upper right", fontsize="small", framealpha=0.9)
        legend.get_frame().set_facecolor("#b0b0b0")
        return figure


def success_map(
    case: Case,
    columns: int | None = None,
    speeds: Sequence[float] | None = None,
    sizes: Sequence[float] | None = None,
    rows: int | None = None,
    workers: Workers = 1,
    checkpoint: Path | str | None = None,
    on_progress: OnProgress = lambda *_: None,
) -> SuccessMap:
    """Find the share of draws that succeed, over entry speeds and sizes, on one surface.

    The zone is the one for the case's parcel. Each size starts wholly on a lead-in of its own
    length; mass stays, inertia goes with the square of the size. The draws are the same in each
    cell, down to the elements of the zone.

    Args:
        case: the parcel, its entry and its purpose.
        columns: of the zone; None: as `sweep.arrange` finds them.
        speeds: [m/s] at entry; None: 40 from 0.1 to 3, or to half as much again as the case's.
        sizes: [-] factors on the base's lengths; None: 40 from 0.5 to 1.5.
        rows: of rotors; None: as many as lie under the case's parcel.
        workers: threads that share the runs, or a cluster.
        checkpoint: file that keeps the finished sizes; a map whose file exists is resumed.
        on_progress: called with the runs done and their total.

    Raises:
        ValueError: a speed that is not from 0 to 20, a size that is not positive or too large, a
            checkpoint of another map or none at all, or see `sweep.arrange`.
    """
    wanted_speeds = np.linspace(0.1, max(3.0, 1.5 * case.speed), 40) if speeds is None else speeds
    wanted_sizes = np.linspace(0.5, 1.5, 40) if sizes is None else sizes
    over = checks.array("speeds", wanted_speeds, (None,))
    factors = checks.array("sizes", wanted_sizes, (None,))
    for name, values in (("speeds", over), ("sizes", factors)):
        if len(values) == 0:
            raise ValueError(f"{name} must be at least one, got none")
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
        found = np.array(load_checkpoint(file, "map", identity, ("found",))["found"])
    largest = _scaled(case.parcel, float(factors.max()))
    whole = _line_for_size(arrangement.line, case, largest)
    body, pitch = largest.body, (whole.pitch_x, whole.pitch_y)
    check_capacity(len(body.edges), body.radius, pitch, whole.shape[::-1])
    groups = list(case.unknown.by_group().values())
    drawn = [case.draw(whole, unknown) for unknown in (groups[0], groups[-1])]
    counts = [len(over) * len(each) for each in drawn]
    progress = split_progress(on_progress, counts * len(factors))
    points = replace(repeat_case(case, len(over)), speed=over)
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
            save_checkpoint(file, identity, {"found": found})
    on_progress(sum(counts) * len(factors), sum(counts) * len(factors))
    return SuccessMap(over, factors, found[0] > 0.5, found[1], arrangement)


def _scaled_draws(drawn: Draws, size: float, columns: int) -> Draws:
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


def _line_for_size(line: DesignLine, case: Case, parcel: Parcel) -> DesignLine:
    """Return the case's line with a lead-in, a run-out and supports for another parcel."""
    own = line_for(parcel, line.columns, line.rows, case.pitch)
    return replace(line, lead_in=own.lead_in, run_out=own.run_out, beside=own.beside)
