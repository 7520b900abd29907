"""Files of trajectories: all of one as .npz, its motion as .csv."""

import csv
import zipfile
import zlib
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.physics.types import STATE_SIZE, Array, check_capacity
from surface_gym.surface import Surface

if TYPE_CHECKING:
    from surface_gym.trajectory import Run, Trajectory

Parts = dict[str, NDArray[Any]]
Fields = dict[str, Any]  # of a dataclass

SUFFIXES = (".npz", ".csv")
END = "# end: "  # begins the first line of a .csv
COLUMNS = (
    *("time [s]", "x [m]", "y [m]", "theta [rad]"),
    *("vx [m/s]", "vy [m/s]", "omega [rad/s]", "tipping"),
)
MOTION = ("time", "pose", "velocity", "tipping", "end")
SURFACE = ("axis", "rotor", "pitch", "origin", "mu_max", "mu_min", "mu_support", "tilt")
PARCEL = ("mass", "com_height", "com_offset")
RUN = ("dt", "method", "normal_forces", "states")
MAY_BE_NONE = ("stiffness", "inertia")  # absent then
ALL = (*SURFACE, *PARCEL, *RUN, "base", "base_lengths")

# A base's name and its lengths [m]: length and width, radius, or vertices (vertices, 2).
BASES: dict[str, Callable[[Array], Base]] = {
    "rectangle": lambda lengths: Rectangle(*lengths.tolist()),
    "disc": lambda lengths: Disc(*lengths.tolist()),
    "polygon": lambda lengths: Polygon(lengths),
}


def save_trajectory(trajectory: "Trajectory", path: str | PathLike[str]) -> None:
    """Write a trajectory to a file, as `Trajectory.save` describes."""
    file = _checked_file(path)
    _check_end(trajectory.end)
    if file.suffix == ".csv":
        with file.open("w", encoding="utf-8", newline="") as stream:
            _write_table(stream, trajectory)
        return
    parts: dict[str, Any] = {name: np.asarray(getattr(trajectory, name)) for name in MOTION}
    if trajectory.run is not None:
        parts |= _run_parts(trajectory.run)
    with file.open("wb") as packed:
        np.savez_compressed(packed, **parts)


def load_fields(path: str | PathLike[str]) -> tuple[Fields, Fields | None]:
    """Read the fields of a trajectory without its run, and those of its run if there is one."""
    file = _checked_file(path)
    try:
        return (_read_table(file), None) if file.suffix == ".csv" else _read_arrays(file)
    except ValueError as error:
        raise ValueError(
            f"path must lead to a trajectory that was saved, got {str(path)!r}: {error}"
        ) from None


def _checked_file(path: str | PathLike[str]) -> Path:
    file = Path(path)
    if file.suffix not in SUFFIXES:
        raise ValueError(f"path must end in {' or '.join(SUFFIXES)}, got {str(path)!r}")
    return file


def _check_end(end: str) -> None:
    if not isinstance(end, str) or not end.strip() or len(end.splitlines()) != 1:
        raise ValueError(f"end must be one line of text, got {end!r}")


def _check_time(time: Array) -> Array:
    rows = _checked_rows("time", time, (None,))
    if len(rows) == 0 or rows[0] != 0.0 or (np.diff(rows) <= 0.0).any():
        raise ValueError("time must begin at 0 and rise")
    return rows


def _checked_rows(name: str, value: NDArray[Any], shape: tuple[int | None, ...]) -> Array:
    """Return numbers as finite float64 of a shape (None: any length), or raise an error."""
    if value.dtype != np.float64:
        raise ValueError(f"{name} must be of float64, got {value.dtype}")
    return checks.array(name, value, shape).copy()


def _read_arrays(file: Path) -> tuple[Fields, Fields | None]:
    """Read an .npz; each array is checked where it is used."""
    parts = _unpack(file)
    _check_missing([name for name in MOTION if name not in parts])
    time = _check_time(parts["time"])
    rows = len(time)
    motion = {name: _checked_rows(name, parts[name], (rows, 3)) for name in ("pose", "velocity")}
    tipping, end = parts["tipping"], parts["end"].item() if parts["end"].ndim == 0 else ""
    if tipping.dtype != np.bool_ or tipping.shape != time.shape:
        raise ValueError(
            f"tipping must be booleans of the shape {time.shape}, "
            f"got {tipping.dtype} of {tipping.shape}"
        )
    _check_end(end)
    return {"time": time, **motion, "tipping": tipping, "end": end}, _run_fields(parts, rows)


def _unpack(file: Path) -> Parts:
    """Read the arrays of an .npz; none may hold Python objects."""
    with file.open("rb") as packed:
        if not zipfile.is_zipfile(packed):
            raise ValueError("it is no .npz, or only the beginning of one")
        packed.seek(0)
        try:
            with np.load(packed, allow_pickle=False) as archive:
                return {name: np.asarray(archive[name]) for name in archive.files}
        except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, SyntaxError) as error:
            raise ValueError(f"it is damaged ({error})") from None


def _check_missing(missing: list[str]) -> None:
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")


def _run_parts(run: "Run") -> Parts:
    """Convert a run to arrays by name."""
    surface, parcel = run.surface, run.parcel
    for name, part, kind in (("surface", surface, Surface), ("parcel", parcel, Parcel)):
        if type(part) is not kind:
            raise ValueError(
                f"{name} must be a {kind.__name__}, not a user-defined class, to be saved as "
                f".npz, got a {type(part).__name__}; a .csv holds the motion alone"
            )
    base, lengths = _base_parts(parcel.base)
    parts = {name: np.asarray(getattr(surface, name)) for name in SURFACE}
    parts |= {name: np.asarray(getattr(parcel, name)) for name in PARCEL}
    parts |= {name: np.asarray(getattr(run, name)) for name in RUN}
    parts |= {"base": np.asarray(base), "base_lengths": lengths}
    if surface.stiffness is not None:
        parts["stiffness"] = surface.stiffness
    if parcel.inertia is not None:
        parts["inertia"] = np.asarray(parcel.inertia)
    return parts


def _base_parts(base: Base) -> tuple[str, Array]:
    if type(base) is Rectangle:
        return "rectangle", np.array([base.length, base.width])
    if type(base) is Disc:
        return "disc", np.array([base.radius])
    if type(base) is Polygon:
        return "polygon", base.vertices
    raise ValueError(
        f"base must be a Rectangle, a Disc or a Polygon to be saved as .npz, got {base!r}; "
        "a .csv holds the motion alone"
    )


def _run_fields(parts: Parts, rows: int) -> Fields | None:
    """Convert arrays by name back to the fields of a run; None if they hold nothing of one."""
    missing = [name for name in ALL if name not in parts]
    if len(missing) == len(ALL):
        return None
    _check_missing(missing)
    plain: Fields = {
        name: parts[name].item() if parts[name].ndim == 0 else parts[name]
        for name in (*ALL, *MAY_BE_NONE)
        if name in parts
    }
    surface = Surface(**{name: plain[name] for name in SURFACE}, stiffness=plain.get("stiffness"))
    lengths = checks.array("base_lengths", plain["base_lengths"], parts["base_lengths"].shape)
    make_base = BASES[checks.one_of("base", plain["base"], BASES)]
    try:
        base = make_base(lengths)
    except TypeError:
        raise ValueError(
            f"base_lengths must be those of a {plain['base']}, got {lengths}"
        ) from None
    parcel = Parcel(base, **{name: plain[name] for name in PARCEL}, inertia=plain.get("inertia"))
    check_capacity(
        len(parcel.body.edges),
        parcel.body.radius,
        (surface.pitch_x, surface.pitch_y),
        (surface.columns, surface.rows),
    )
    return {
        "surface": surface,
        "parcel": parcel,
        "dt": checks.positive("dt", plain["dt"]),
        "method": checks.one_of("method", plain["method"], ("implicit", "explicit")),
        "normal_forces": checks.one_of(
            "normal_forces", plain["normal_forces"], ("dual", "osqp", "scipy")
        ),
        "states": _checked_rows("states", parts["states"], (rows, STATE_SIZE)),
    }


def _write_table(stream: TextIO, trajectory: "Trajectory") -> None:
    stream.write(f"{END}{trajectory.end}\n")
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(COLUMNS)
    motion = np.column_stack([trajectory.time, trajectory.pose, trajectory.velocity])
    for row, tipping in zip(motion.tolist(), trajectory.tipping.tolist(), strict=True):
        rows.writerow([*row, int(tipping)])


def _read_table(file: Path) -> Fields:
    """Read a .csv; an error names the line."""
    with file.open(encoding="utf-8-sig", newline="") as stream:
        try:
            end = stream.readline().rstrip("\r\n")
            lines = list(csv.reader(stream, strict=True))
        except UnicodeDecodeError:
            raise ValueError("it is not UTF-8 text") from None
        except csv.Error as error:
            raise ValueError(f"it is not comma-separated values ({error})") from None
    if not end.startswith(END):
        raise ValueError(f"line 1 must begin with {END!r}, got {end!r}")
    end = end[len(END) :]
    _check_end(end)
    if not lines or tuple(lines[0]) != COLUMNS:
        found = ",".join(lines[0]) if lines else ""
        raise ValueError(f"line 2 must be {','.join(COLUMNS)!r}, got {found!r}")
    rows = np.array([_numbers(line, row) for line, row in enumerate(lines[1:], start=3)])
    table = rows.reshape(-1, len(COLUMNS))
    time, pose, velocity = _check_time(table[:, 0]), table[:, 1:4].copy(), table[:, 4:7].copy()
    tipping = table[:, 7] == 1.0
    return {"time": time, "pose": pose, "velocity": velocity, "tipping": tipping, "end": end}


def _numbers(line: int, row: list[str]) -> list[float]:
    if len(row) != len(COLUMNS):
        raise ValueError(f"line {line} must have {len(COLUMNS)} entries, got {len(row)}")
    numbers = []
    for name, text in zip(COLUMNS, row, strict=True):
        try:
            numbers.append(checks.number(name, float(text)))
        except ValueError:
            raise ValueError(f"line {line}: {name} must be a finite number, got {text!r}") from None
    checks.one_of(f"line {line}: tipping", row[-1], ("0", "1"))
    return numbers
