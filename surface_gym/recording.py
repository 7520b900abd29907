"""Recordings of runs, frame by frame, and their compact file format.

A file holds positions to 0.05 mm, angles to 0.1 mrad and forces to 0.02 N. Numbers are rounded, and
predicted linearly from the two numbers before them. The file stores the compressed prediction
errors.
"""

import json
import math
import zlib
from dataclasses import asdict, dataclass, field, fields
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks, files
from surface_gym.physics.types import Array, Booleans, Integers

FORMAT, VERSION = "surface_gym recording", 2
WITHOUT_BEARERS = 1  # file version with forces on one parcel only
DRIVEN = 3  # file version with driven modules
SUFFIX = ".replay"
MARKS = ("line", "path", "zone", "exit", "inlet")
MOST_BYTES = 2**30  # maximum size of a recording in memory: days of a stream
MOST_HEADER = 2**26  # [bytes]
SMALL_HEADER = 2**21  # [bytes] that any file's header may have
HEADER_RATIO = 50  # [-] of the bytes of a larger header over the file's
ANGLES = 256  # maximum number of different axes in a recording, and of velocities of modules
FINEST = 0.01  # [m/s] resolution of velocities of modules, if there are few

# Resolution of the numbers in a file.
TIME = (1e-5,)  # [s]
MOTION = (5e-5, 5e-5, 1e-4, 5e-4, 5e-4, 1e-3)  # [m, m, rad, m/s, m/s, rad/s]
CONTACT = (1.0, 0.02, 0.02, 0.02)  # [module, N, N, N]
BEARER = (1.0,)  # [parcel]
PUSH = (1.0, 1.0, 1e-3, 1e-3, 0.02, 0.02)  # [parcel, parcel, m, m, N, N]


def _no_indices() -> Integers:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Mark:
    """A fixed drawing on a surface: a goal, the zone, an exit or an inlet."""

    kind: str  # one of MARKS; zones, exits and inlets are areas
    points: Array  # (points, 2) [m] corners of an area, or points of a line
    label: str = ""
    colour: int | str | None = None  # index of an exit's colour, or a palette name; None: a goal's

    def __post_init__(self) -> None:
        checks.one_of("kind", self.kind, MARKS)
        checks.settle(self, points=(checks.array, (None, 2)))
        if len(self.points) < 2:
            raise ValueError(f"points must be at least 2, got {len(self.points)}")
        _check_look(self.label, self.colour)


@dataclass(frozen=True, eq=False)
class RecordedParcel:
    """A parcel, and its motion in the frames in which it is present."""

    outline: Array  # (points, 2) [m] outline of the base in its own frame
    first: int  # frame of the first row
    pose: Array  # (rows, 3) [m, m, rad] pose of the base's frame
    velocity: Array  # (rows, 3) [m/s, m/s, rad/s]
    label: str = ""
    colour: int | str | None = None  # index of an exit's or group's colour; None: grey

    def __post_init__(self) -> None:
        checks.settle(self, outline=(checks.array, (None, 2)))
        if len(self.outline) < 3:
            raise ValueError(f"outline must have at least 3 points, got {len(self.outline)}")
        checks.settle(self, first=(checks.integer, 0), pose=(checks.pose, (None, 3)))
        rows = len(self.pose)
        checks.settle(self, velocity=(checks.velocity, (rows, 3)))
        if rows == 0:
            raise ValueError("pose must have at least one row, got none")
        _check_look(self.label, self.colour)


@dataclass(frozen=True, eq=False)
class Recording:
    """A run, frame by frame: the surface, its axes, parcels, numbers, and forces if known.

    `surface_gym.RecordReplay` records an environment's episodes. `surface_gym.replay` shows
    recordings in a page.
    """

    title: str
    control_period: float  # [s] between frames
    time: Array  # (T,) [s] increasing
    rotor: Booleans  # (rows, columns) an orientable rotor, else a support
    angles: Array  # (angles,) [rad] the distinct axes, at most 256
    axis: NDArray[np.uint8]  # (T, rows, columns) index of each module's axis in `angles`
    pitch: tuple[float, float] = (0.1, 0.1)  # [m] from column to column, and from row to row
    origin: tuple[float, float] = (0.05, 0.05)  # [m] centre of module [0, 0]
    obeys: Booleans | None = None  # (rows, columns) whether a module obeys commands; None: all do
    # [m] view: smallest x and y, largest x and y; None: the surface
    view: tuple[float, float, float, float] | None = None
    marks: tuple[Mark, ...] = ()
    parcels: tuple[RecordedParcel, ...] = ()
    heading: float | None = None  # [rad] goal angle of the parcel
    # (T + 1,) first contact of each frame; empty: a recording without forces
    first_contact: Integers = field(default_factory=_no_indices)
    # (contacts, 4) row times columns plus column of the element, then [N] normal force, and
    # friction on the parcel in x and y
    contacts: Array = field(default_factory=lambda: np.zeros((0, 4)))
    # (contacts,) parcel of each contact; empty: the first parcel
    bearer: Integers = field(default_factory=_no_indices)
    first_push: Integers = field(default_factory=_no_indices)  # (T + 1,) like first_contact
    # (pushes, 6) two parcels that push each other, [m] point of action in x and y, and [N] force on
    # the second in x and y
    pushes: Array = field(default_factory=lambda: np.zeros((0, 6)))
    # (T, exits) number of parcels delivered correctly to each exit mark
    delivered: Array = field(default_factory=lambda: np.zeros((0, 0)))
    metrics: dict[str, Array] = field(default_factory=dict)  # (T,) by name; NaN: not known
    outcome: str = ""  # outcome of the run
    # (velocities, 2) [m/s] distinct velocities of driven modules, NaN: idle; empty: all are idle
    velocities: Array = field(default_factory=lambda: np.zeros((0, 2)))
    # (T, rows, columns) index of each module's velocity in `velocities`
    drive: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 0), dtype=np.uint8))

    def __post_init__(self) -> None:
        for name in ("title", "outcome"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"{name} must be a text, got {getattr(self, name)!r}")
        checks.positive("control_period", self.control_period)
        checks.set_fields(self, marks=tuple(self.marks), parcels=tuple(self.parcels))
        checks.settle(
            self, time=(checks.array, (None,)), rotor=checks.booleans,
            angles=(checks.array, (None,)), pitch=(checks.array, (2,)), origin=checks.place,
            obeys=checks.booleans, view=(checks.array, (4,)), heading=checks.number,
            contacts=(checks.array, (None, 4)), pushes=(checks.array, (None, 6)),
            delivered=(checks.array, (None, None)),
        )  # fmt: skip
        _check_time(self.time)
        self._check_indices("axis", "angles", self.angles)
        if len(self.velocities) or np.size(self.drive):
            self._check_indices("drive", "velocities", self.velocities)
            velocities = np.array(self.velocities, dtype=np.float64)
            if velocities.shape != (len(velocities), 2):
                raise ValueError(f"velocities must be (any, 2), got {velocities.shape}")
            velocities.setflags(write=False)
            checks.set_fields(self, velocities=velocities)
        pitch = tuple(checks.positive("pitch", each) for each in np.array(self.pitch).tolist())
        checks.set_fields(self, pitch=pitch)
        if self.obeys is not None and self.obeys.shape != self.rotor.shape:
            raise ValueError(f"obeys must have rotor's shape, got {self.obeys.shape}")
        if self.view is not None:
            left, low, right, high = np.array(self.view).tolist()
            if right <= left or high <= low:
                raise ValueError(f"view must enclose an area, got {self.view}")
            checks.set_fields(self, view=(left, low, right, high))
        self._check_parcels()
        self._check_forces()
        count, exits = len(self.time), sum(mark.kind == "exit" for mark in self.marks)
        if self.delivered.size and self.delivered.shape != (count, exits):
            raise ValueError(
                f"delivered must have a row a frame and a column an exit, {(count, exits)}, "
                f"got {self.delivered.shape}"
            )
        metrics = {
            name: np.array(values, dtype=np.float64) for name, values in self.metrics.items()
        }
        for name, values in metrics.items():
            if values.shape != (count,):
                raise ValueError(f"metrics[{name!r}] must have {count} rows, got {values.shape}")
        checks.set_fields(self, metrics=metrics)

    def _check_indices(self, name: str, of: str, values: Array) -> None:
        """Check that the field `name` holds indices into the array `values`.

        `of` is the name of this array in the error.
        """
        shape, count = (len(self.time), *self.rotor.shape), len(values)
        index = np.array(getattr(self, name))
        if index.dtype != np.uint8 or index.shape != shape:
            raise ValueError(
                f"{name} must be uint8 of the shape {shape}, got {index.dtype} of {index.shape}"
            )
        if not 1 <= count <= ANGLES or index.max() >= count:
            raise ValueError(
                f"{name} must be indices among {of}, of which there are 1 to {ANGLES}, got "
                f"{index.max()} among {count}"
            )
        index.setflags(write=False)
        checks.set_fields(self, **{name: index})

    def _check_parcels(self) -> None:
        for k, each in enumerate(self.parcels):
            last = each.first + len(each.pose)
            if last > len(self.time):
                raise ValueError(
                    f"parcels[{k}] must be within the {len(self.time)} frames, got frame {last - 1}"
                )

    def _check_forces(self) -> None:
        element, bearer = self.contacts[:, 0], np.array(self.bearer, dtype=np.int64)
        if len(element) and not (element.min() >= 0 and element.max() < self.rotor.size):
            raise ValueError(f"contacts must be on the {self.rotor.size} elements")
        if not bearer.size:
            bearer = np.zeros(len(self.contacts), dtype=np.int64)
        if len(bearer) != len(self.contacts):
            raise ValueError(
                f"bearer must have a parcel for each of {len(self.contacts)} contacts, "
                f"got {len(bearer)}"
            )
        checks.set_fields(self, bearer=bearer)
        count = len(self.parcels)
        for name, index in (("bearer", bearer), ("pushes", self.pushes[:, :2])):
            if index.size and not (index.min() >= 0 and index.max() < count):
                raise ValueError(f"{name} must be of the {count} parcels")
        self._check_first("first_contact", "contacts")
        self._check_first("first_push", "pushes")

    def _check_first(self, name: str, of: str) -> None:
        """Check the field `name`, which gives the first row of each frame in the field `of`."""
        first, total = np.array(getattr(self, name), dtype=np.int64), len(getattr(self, of))
        ends = len(first) == len(self.time) + 1 and first[0] == 0 and first[-1] == total
        if len(first) and not (ends and (np.diff(first) >= 0).all()):
            raise ValueError(f"{name} must rise from 0 to the number of {of}, one more than frames")
        if not len(first) and total:
            raise ValueError(f"{name} must say which frames {of} belong to, got none")
        checks.set_fields(self, **{name: first})

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.time)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the recording to a file ending in .replay; an existing file is replaced."""
        with files.replacing(checks.path("path", path, SUFFIX)) as part:
            part.write_bytes(self.encode())

    @staticmethod
    def load(path: str | PathLike[str]) -> "Recording":
        """Read a file written by `save`. Only numbers and text are read, and no code is executed.

        Raises:
            ValueError: the file holds no recording; the message names the problem.
            FileNotFoundError: the file does not exist.
        """
        file = checks.path("path", path, SUFFIX)
        try:
            return Recording.decode(files.read_bytes(file, MOST_BYTES))
        except ValueError as error:
            raise ValueError(
                f"path must lead to a recording that was saved, got {str(path)!r}: {error}"
            ) from None

    def encode(self) -> bytes:
        """Encode the recording as bytes. Recording files and pages use this format."""
        motion = [np.hstack([each.pose, each.velocity]) for each in self.parcels]
        is_driven = len(self.velocities) > 0
        tables = [
            _pack("time", self.time[:, np.newaxis], TIME),
            _pack("pose", np.concatenate([np.zeros((0, 6)), *motion]), MOTION),
            _pack("first_contact", np.diff(self.first_contact)[:, np.newaxis], (1.0,)),
            _pack("bearer", self.bearer[:, np.newaxis], BEARER),
            _pack("contacts", self.contacts, CONTACT),
            _pack("first_push", np.diff(self.first_push)[:, np.newaxis], (1.0,)),
            _pack("pushes", self.pushes, PUSH),
            _pack("delivered", self.delivered, (1.0,) * self.delivered.shape[1]),
        ]
        turned, driven = (
            np.diff(each.reshape(len(self), -1), axis=0, prepend=np.uint8(0))
            for each in (self.axis, self.drive if is_driven else self.axis[:, :0])
        )
        metrics = np.array([*self.metrics.values()], dtype="<f4")
        obeys = np.ones_like(self.rotor) if self.obeys is None else self.obeys
        header = {
            "format": FORMAT,
            "version": DRIVEN if is_driven else VERSION,
            "title": self.title,
            "control_period": self.control_period,
            "rows": self.rotor.shape[0],
            "columns": self.rotor.shape[1],
            "pitch": self.pitch,
            "origin": self.origin,
            "view": self.view,
            "heading": self.heading,
            "outcome": self.outcome,
            "angles": self.angles.tolist(),
            "marks": [asdict(each) | {"points": each.points.tolist()} for each in self.marks],
            "parcels": [
                {
                    "outline": each.outline.round(6).tolist(),
                    "first": each.first,
                    "rows": len(each.pose),
                    "label": each.label,
                    "colour": each.colour,
                }
                for each in self.parcels
            ],
            "metrics": list(self.metrics),
            "frames": len(self),
            "counted": len(self.first_contact) > 0,
            "contacts": len(self.contacts),
            "counted_pushes": len(self.first_push) > 0,
            "pushes": len(self.pushes),
            "exits": self.delivered.shape[1],
            "units": {
                "time": TIME,
                "motion": MOTION,
                "bearer": BEARER,
                "contact": CONTACT,
                "push": PUSH,
            },
        }
        if is_driven:
            known = [None if math.isnan(each[0]) else each for each in self.velocities.tolist()]
            header["velocities"] = known
        text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
        grids = [each.tobytes() for each in (self.rotor, obeys, turned, driven)]
        parts = [len(text).to_bytes(4, "little"), text, *grids, *tables, metrics.tobytes()]
        return zlib.compress(b"".join(parts), 9)

    @staticmethod
    def decode(packed: bytes) -> "Recording":
        """Decode the bytes of a file; raise a ValueError if they are invalid."""
        try:
            return _decode(packed)
        except files.DAMAGE as error:
            raise ValueError(files.describe_damage(error)) from None


def index_axes(axes: Array) -> tuple[Array, NDArray[np.uint8]]:
    """Return the distinct angles (angles,) of axes (...) [rad], and each axis's index (...).

    Axes that differ by half a turn count as equal. More than 256 angles are
    rounded to whole degrees.
    """
    half = np.mod(axes, math.pi)
    angles, index = np.unique(half.round(6) % round(math.pi, 6), return_inverse=True)
    if len(angles) > ANGLES:
        degrees = np.rint(np.degrees(half)) % 180.0
        angles, index = np.unique(np.radians(degrees), return_inverse=True)
    return angles, index.reshape(axes.shape).astype(np.uint8)


def index_drives(velocity: Array) -> tuple[Array, NDArray[np.uint8]]:
    """Return the distinct velocities (count, 2) [m/s], and the index of each drive's velocity.

    `velocity` (..., 2) is rounded to 0.01 m/s. If more than 256 velocities remain, the rounding is
    coarser.
    """
    flat, unit = velocity.reshape(-1, 2), FINEST
    idle = np.isnan(flat[:, 0])
    while True:
        rounded = np.rint(np.where(idle[:, np.newaxis], math.inf, flat) / unit) * unit + 0.0
        found, index = np.unique(rounded, axis=0, return_inverse=True)
        if len(found) <= ANGLES:
            break
        unit *= 2.0
    found[np.isinf(found)] = math.nan
    return found, index.reshape(velocity.shape[:-1]).astype(np.uint8)


def _check_time(time: Array) -> None:
    if len(time) == 0 or (np.diff(time) <= 0.0).any():
        raise ValueError("time must hold at least one frame, and rise")


def _check_look(label: str, colour: int | str | None) -> None:
    if not isinstance(label, str):
        raise ValueError(f"label must be a text, got {label!r}")
    if colour is not None and not isinstance(colour, str):
        checks.integer("colour", colour, least=0)


def _firsts(counts: Array) -> Integers:
    """Return each frame's first row, then the total number of rows. Frame k has counts[k] rows."""
    return np.append(0, np.cumsum(counts)).astype(np.int64)


def _pack(name: str, values: NDArray[Any], units: tuple[float, ...]) -> bytes:
    """Pack a table, shape (rows, columns), into bytes that compress well.

    First, each column is rounded to its unit in `units`. Then the second differences of each column
    are mapped to unsigned numbers. The result holds the first bytes of all numbers, then the second
    bytes of all numbers, and so on.
    """
    counts = np.rint(values / np.array(units))
    if counts.size and np.abs(counts).max() >= 2**31:
        raise ValueError(f"{name} must be less than {2**31} units of {units} to be saved")
    change = np.diff(counts.astype(np.int64), n=2, axis=0, prepend=np.zeros((2, len(units))))
    change = change.astype(np.int64)
    folded = ((change << 1) ^ (change >> 63)).T.astype("<u8").reshape(-1, 1)
    planes: bytes = folded.view(np.uint8)[:, :5].T.tobytes()
    return planes


def _unpack(planes: NDArray[np.uint8], units: tuple[float, ...]) -> Array:
    """Compute the table (rows, columns) from the bytes `planes` that `_pack` returned."""
    planes = planes.reshape(5, len(units), -1)
    table = np.empty((planes.shape[2], len(units)))
    for column, unit in enumerate(units):
        padded = np.zeros((len(table), 8), dtype=np.uint8)
        padded[:, :5] = planes[:, column].T
        folded = padded.view("<u8")[:, 0].astype(np.int64)
        change = (folded >> 1) ^ -(folded & 1)
        table[:, column] = np.cumsum(np.cumsum(change)) * unit
    return table


class _RecordingReader:
    """Reader that unpacks the bytes of a recording, one part after the other.

    If the parts of a recording would exceed a total size, the reader raises a ValueError. So a
    false header cannot make the reader unpack too many bytes.
    """

    def __init__(self, packed: bytes) -> None:
        self._unpacker, self._packed = zlib.decompressobj(), packed
        self.most = self._remaining = min(MOST_BYTES, files.most_unpacked(len(packed)))

    def take(self, size: int) -> NDArray[np.uint8]:
        self.check_claim(size)
        self._remaining -= size
        content = bytearray()
        while len(content) < size and (part := self._unpack(size - len(content))):
            content += part
        if len(content) < size:
            raise ValueError(f"it must hold {size} bytes more, got {len(content)}")
        return np.frombuffer(content, dtype=np.uint8)

    def _unpack(self, most: int) -> bytes:
        part = self._unpacker.decompress(self._packed, most)
        self._packed = self._unpacker.unconsumed_tail
        return part

    def check_claim(self, size: int) -> None:
        """Raise a ValueError if unpacking `size` more bytes would exceed the limit."""
        if not 0 <= size <= self._remaining:
            raise ValueError(f"it must unpack to at most {self.most} bytes, got more")

    def table(self, rows: int, units: tuple[float, ...]) -> Array:
        if rows == 0 or not units:
            return np.zeros((rows, len(units)))
        return _unpack(self.take(5 * rows * len(units)), units)

    def check_end(self) -> None:
        if self._unpack(1):
            raise ValueError("it must end, got more bytes")
        if not self._unpacker.eof:
            raise ValueError("it is cut short")


def _decode(packed: bytes) -> Recording:
    reader = _RecordingReader(packed)
    size = int.from_bytes(reader.take(4).tobytes(), "little")
    most = min(MOST_HEADER, max(SMALL_HEADER, HEADER_RATIO * len(packed)))
    if size > most:
        raise ValueError(f"its header must have at most {most} bytes, got {size}")
    head = json.loads(reader.take(size).tobytes().decode())
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise ValueError(f"its format must be {FORMAT!r}")
    version = checks.one_of("version", head["version"], (WITHOUT_BEARERS, VERSION, DRIVEN))
    if version == WITHOUT_BEARERS:
        head |= {"pushes": 0, "counted_pushes": False}
    count = {
        name: checks.integer(name, head[name], least=0, most=reader.most)
        for name in ("rows", "columns", "frames", "contacts", "pushes", "exits")
    }
    checks.integer("exits", count["exits"], 0, len(head["marks"]))
    shape, frames = (count["rows"], count["columns"]), count["frames"]
    grid = shape[0] * shape[1]
    rows = [checks.integer("rows", each["rows"], least=1) for each in head["parcels"]]
    grids = 2 if version == DRIVEN else 1
    reader.check_claim(
        (2 + grids * frames) * grid + 5 * (frames * (1 + count["exits"]) + 6 * sum(rows))
    )
    rotor = reader.take(grid).reshape(shape).astype(bool)
    obeys = reader.take(grid).reshape(shape).astype(bool)
    turned = [reader.take(frames * grid).reshape(frames, *shape) for _ in range(grids)]
    driven: dict[str, Any] = {}
    if version == DRIVEN:
        known = [(math.nan, math.nan) if each is None else each for each in head["velocities"]]
        driven = {"velocities": np.array(known), "drive": np.cumsum(turned[1], 0, dtype=np.uint8)}
    time = reader.table(frames, TIME)[:, 0]
    _check_time(time)
    motion = np.split(reader.table(sum(rows), MOTION), np.cumsum(rows)[:-1]) if rows else []
    counted = reader.table(frames if head["counted"] else 0, (1.0,))[:, 0]
    bearers = 0 if version == WITHOUT_BEARERS else count["contacts"]
    bearer = reader.table(bearers, BEARER)[:, 0].astype(np.int64)
    contacts = reader.table(count["contacts"], CONTACT)
    counted_pushes = reader.table(frames if head["counted_pushes"] else 0, (1.0,))
    pushes = reader.table(count["pushes"], PUSH)
    delivered = reader.table(frames if count["exits"] else 0, (1.0,) * count["exits"])
    names = head["metrics"]
    values = reader.take(4 * frames * len(names)).view("<f4").reshape(len(names), frames)
    reader.check_end()
    return Recording(
        time=time,
        rotor=rotor,
        axis=np.cumsum(turned[0], axis=0, dtype=np.uint8),
        obeys=None if obeys.all() else obeys,
        marks=tuple(
            Mark(**{each.name: mark[each.name] for each in fields(Mark)}) for mark in head["marks"]
        ),
        parcels=tuple(
            RecordedParcel(
                **{name: each[name] for name in ("outline", "first", "label", "colour")},
                pose=row[:, :3],
                velocity=row[:, 3:],
            )
            for each, row in zip(head["parcels"], motion, strict=True)
        ),
        first_contact=_firsts(counted) if head["counted"] else _no_indices(),
        contacts=contacts,
        bearer=bearer,
        first_push=_firsts(counted_pushes[:, 0]) if head["counted_pushes"] else _no_indices(),
        pushes=pushes,
        delivered=delivered,
        metrics=dict(zip(names, values.astype(np.float64), strict=True)),
        **{
            name: head[name]
            for name in ("title", "control_period", "angles", "pitch", "origin", "view")
        },
        heading=head["heading"],
        outcome=head["outcome"],
        **driven,
    )
