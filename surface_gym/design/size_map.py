"""Over which entry speeds and sizes of a parcel one surface does what is asked."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.case import Case, Draws
from surface_gym.design.line import DesignLine, line_for
from surface_gym.design.sending import Advance
from surface_gym.design.sweep import Arrangement, arrange, groups_of, own_conditions, shares
from surface_gym.parcel import Parcel
from surface_gym.physics.types import check_capacity
from surface_gym.sharing import Workers
from surface_gym.whole_files import replacing

Booleans = NDArray[np.bool_]
Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SuccessMap:
    """Success over entry speeds and sizes."""

    speeds: Numbers  # (speeds,) [m/s]
    sizes: Numbers  # (sizes,) [-] lengths of the base over the case's
    nominal: Booleans  # (sizes, speeds) success with nothing unknown
    share: Numbers  # (sizes, speeds) of the draws that succeed
    arrangement: Arrangement


def success_map(
    case: Case,
    columns: int | None = None,
    speeds: Sequence[float] | None = None,
    sizes: Sequence[float] | None = None,
    rows: int | None = None,
    workers: Workers = 1,
    checkpoint: Path | str | None = None,
    advance: Advance = lambda *_: None,
) -> SuccessMap:
    """The share of draws that succeed, over entry speeds and sizes, on one surface.

    The zone is the one for the case's parcel. Each size starts wholly on a lead-in of its own
    length; mass stays, inertia goes with the square of the size. The draws are the same in each
    cell, down to the elements of the zone.

    Args:
        case: what it is for.
        columns: of the zone; None: as `sweep.arrange` finds them.
        speeds: [m/s] at entry; None: 40 from 0.1 to 3, or to half as much again as the case's.
        sizes: [-] factors on the base's lengths; None: 40 from 0.5 to 1.5.
        rows: of rotors; None: as many as lie under the case's parcel.
        workers: threads that share the runs, or a cluster.
        checkpoint: file that keeps the sizes that are done; a map whose file exists goes on from
            there.
        advance: called with how many runs are done and how many there are.

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
    keeper = None if checkpoint is None else Path(checkpoint)
    told = _told(arrangement, over, factors)
    found = np.full((2, len(factors), len(over)), math.nan)
    if keeper is not None and keeper.exists():
        found = _read(keeper, told)
    largest = _scaled(case.parcel, float(factors.max()))
    whole = _lined(arrangement.line, case, largest)
    body, pitch = largest.body, (whole.pitch_x, whole.pitch_y)
    check_capacity(len(body.edges), body.radius, pitch, whole.shape[::-1])
    groups = groups_of(case.unknown)
    names = [next(iter(groups)), list(groups)[-1]]
    drawn = [replace(arrangement, line=whole).drawn(groups[name]) for name in names]
    count = len(over) * sum(map(len, drawn))
    for row, size in enumerate(factors.tolist()):
        if not np.isnan(found[0, row, 0]):
            continue

        def counted(done: int, before: int, row: int = row) -> None:
            advance(row * count + before + done, len(factors) * count)

        found[:, row] = _row(arrangement, whole, drawn, size, over, workers, counted)
        if keeper is not None:
            _write(keeper, told, found)
    advance(len(factors) * count, len(factors) * count)
    return SuccessMap(over, factors, found[0] > 0.5, found[1], arrangement)


def _row(
    arrangement: Arrangement, whole: DesignLine, drawn: list[Draws], size: float, speeds: Numbers,
    workers: Workers, counted: Advance,
) -> Numbers:  # fmt: skip
    """(2, speeds) success with nothing unknown, and the share of the draws, at one size."""
    case = arrangement.case
    parcel = _scaled(case.parcel, size)
    line = replace(whole, lead_in=_lined(arrangement.line, case, parcel).lead_in)
    own = replace(arrangement, case=replace(case, parcel=parcel), line=line)
    at = replace(own_conditions(case, len(speeds)), speed=speeds)
    found = []
    before = 0
    for each in drawn:
        cut = _cut(each, size, whole.lead_in - line.lead_in)

        def advance(done: int, _: int, before: int = before) -> None:
            counted(done, before)

        found.append(shares(own, cut, at, workers, advance))
        before += len(each) * len(speeds)
    return np.array(found)


def _cut(drawn: Draws, size: float, columns: int) -> Draws:
    """The same draws of parcels of another size, on a line whose lead-in is shorter."""
    ground = drawn.stiffness
    return replace(
        drawn,
        parcels=tuple(_scaled(parcel, size) for parcel in drawn.parcels),
        stiffness=None if ground is None else ground[:, :, columns:],
    )


def _scaled(parcel: Parcel, size: float) -> Parcel:
    """The same parcel with every length of its base times a factor."""
    x, y = parcel.com_offset
    return replace(
        parcel,
        base=parcel.base.scaled(size),
        inertia=parcel.moment_of_inertia * size**2,
        com_offset=(size * x, size * y),
    )


def _lined(line: DesignLine, case: Case, parcel: Parcel) -> DesignLine:
    """The case's line with a lead-in, a run-out and supports for another parcel."""
    own = line_for(parcel, line.columns, line.rows, case.pitch)
    return replace(line, lead_in=own.lead_in, run_out=own.run_out, beside=own.beside)


def _told(arrangement: Arrangement, speeds: Numbers, sizes: Numbers) -> dict[str, str]:
    """What a map is of, each part in words that differ where it differs."""
    case = arrangement.case
    told = {field.name: repr(getattr(case, field.name)) for field in fields(case)}
    parcel = case.parcel
    outline = (type(parcel.base).__name__, parcel.base.outline.tolist())
    load = (parcel.moment_of_inertia, parcel.mass, parcel.com_height, parcel.com_offset)
    told["parcel"] = repr((*outline, *load))
    return {
        **told,
        "columns": repr(arrangement.columns),
        "rows": repr(arrangement.line.rows),
        "speeds": repr(speeds.tolist()),
        "sizes": repr(sizes.tolist()),
    }


def _write(file: Path, told: dict[str, str], found: Numbers) -> None:
    """Keep what is done; a write that is broken off leaves the file as it was."""
    with replacing(file) as part, part.open("wb") as stream:
        np.savez(stream, names=list(told), told=list(told.values()), found=found)


def _read(file: Path, told: dict[str, str]) -> Numbers:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
            names, parts, found = kept["names"].tolist(), kept["told"].tolist(), kept["found"]
    except (BadZipFile, EOFError, KeyError, ValueError):
        raise ValueError(f"checkpoint must be one of a map, got {file}") from None
    its = dict(zip(names, parts, strict=True))
    for name, wanted in told.items():
        if its.get(name) != wanted:
            raise ValueError(
                f"checkpoint must be of this map, got {file} of another {name}: "
                f"{_short(its.get(name))}, not {_short(wanted)}"
            )
    return np.array(found, dtype=np.float64)


def _short(told: str | None) -> str:
    return "none" if told is None else told if len(told) <= 60 else f"{told[:57]}..."
