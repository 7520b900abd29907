"""Trajectories in files: all of one as .npz, its motion as .csv."""

import csv
import zipfile
import zlib
from os import PathLike
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from surface_gym import checks
from surface_gym.physics.types import Array
from surface_gym.record.parts import Parts, check_rows, run_of, run_parts
from surface_gym.trajectory import Trajectory

SUFFIXES = (".npz", ".csv")
END = "# end: "  # begins the first line of a .csv
COLUMNS = (
    *("time [s]", "x [m]", "y [m]", "theta [rad]"),
    *("vx [m/s]", "vy [m/s]", "omega [rad/s]", "tipping"),
)


def save(trajectory: Trajectory, path: str | PathLike[str]) -> None:
    """See `Trajectory.save`."""
    file = _file(path)
    _check_end(trajectory.end)
    if file.suffix == ".csv":
        with file.open("w", encoding="utf-8", newline="") as stream:
            _write_lines(stream, trajectory)
        return
    parts: dict[str, Any] = {
        name: np.asarray(getattr(trajectory, name))
        for name in ("time", "pose", "velocity", "tipping", "end")
    }
    if trajectory.run is not None:
        parts |= run_parts(trajectory.run)
    with file.open("wb") as packed:
        np.savez_compressed(packed, **parts)


def load(path: str | PathLike[str]) -> Trajectory:
    """See `Trajectory.load`."""
    file = _file(path)
    read = _read_lines if file.suffix == ".csv" else _read_parts
    try:
        return read(file)
    except ValueError as error:
        raise ValueError(
            f"path must lead to a trajectory that was saved, got {str(path)!r}: {error}"
        ) from None


def _file(path: str | PathLike[str]) -> Path:
    file = Path(path)
    if file.suffix not in SUFFIXES:
        raise ValueError(f"path must end in {' or '.join(SUFFIXES)}, got {str(path)!r}")
    return file


def _check_end(end: str) -> None:
    if not isinstance(end, str) or not end.strip() or len(end.splitlines()) != 1:
        raise ValueError(f"end must be one line of text, got {end!r}")


def _read_parts(file: Path) -> Trajectory:
    """Of an .npz, each part of which is checked as its values come to be used."""
    parts = _unpack(file)
    missing = [name for name in ("time", "pose", "velocity", "tipping", "end") if name not in parts]
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
    time = _check_time(parts["time"])
    motion = {name: check_rows(name, parts[name], (len(time), 3)) for name in ("pose", "velocity")}
    tipping, end = parts["tipping"], parts["end"].item() if parts["end"].ndim == 0 else ""
    if tipping.dtype != np.bool_ or tipping.shape != time.shape:
        raise ValueError(
            f"tipping must be booleans of the shape {time.shape}, "
            f"got {tipping.dtype} of {tipping.shape}"
        )
    _check_end(end)
    return Trajectory(time, **motion, tipping=tipping, end=end, run=run_of(parts, len(time)))


def _unpack(file: Path) -> Parts:
    """The arrays of an .npz; none may hold Python's objects."""
    with file.open("rb") as packed:
        if not zipfile.is_zipfile(packed):
            raise ValueError("it is no .npz, or only the beginning of one")
        packed.seek(0)
        try:
            with np.load(packed, allow_pickle=False) as archive:
                return {name: np.asarray(archive[name]) for name in archive.files}
        except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, SyntaxError) as error:
            raise ValueError(f"it is damaged ({error})") from None


def _check_time(time: Array) -> Array:
    rows = check_rows("time", time, (None,))
    if len(rows) == 0 or rows[0] != 0.0 or (np.diff(rows) <= 0.0).any():
        raise ValueError("time must begin at 0 and rise")
    return rows


def _write_lines(stream: TextIO, trajectory: Trajectory) -> None:
    stream.write(f"{END}{trajectory.end}\n")
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(COLUMNS)
    motion = np.column_stack([trajectory.time, trajectory.pose, trajectory.velocity])
    for row, tipping in zip(motion.tolist(), trajectory.tipping.tolist(), strict=True):
        rows.writerow([*row, int(tipping)])


def _read_lines(file: Path) -> Trajectory:
    """Of a .csv; an error names the line."""
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
    time = _check_time(table[:, 0])
    return Trajectory(time, table[:, 1:4].copy(), table[:, 4:7].copy(), table[:, 7] == 1.0, end)


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
