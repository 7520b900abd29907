"""Messages between a machine and its controller, and their format as lines of JSON.

Times are in s, by one monotonic clock. Poses refer to the centroid of a parcel's base. Each line
has a `kind`. The machine sends the kinds "entered", "frame", "detections", "taken" (a command is
acknowledged) and "left". The controller sends "axes" and "gate". All fields are checked.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks, files
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle

MAX_TEXT = 1000  # maximum characters of a text
MAX_NUMBER = 2**53  # maximum number of a parcel or a command
MAX_VERTICES = 256  # maximum vertices of a base
MAX_LATE = 1.0  # [s] maximum time from an event, such as a picture, to its message
MAX_EARLY = 0.05  # [s] maximum time of a message before its event
MAX_DETECTIONS = 512  # maximum poses of a picture: twice the most parcels on a line

Angles = NDArray[np.float64]  # (rows, columns) [rad] of the zone's modules, row by row from y < 0
Triple = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class ParcelEntry:
    """Message that a parcel enters the surface, or waits at the gate of a stream."""

    number: int  # unique number of the parcel
    at: float  # [s] time of the pose and the velocity
    parcel: Parcel  # base and mass; the load is assumed even
    pose: Triple  # [m, m, rad] roughly, from the conveyor and its guides
    velocity: Triple  # [m/s, m/s, rad/s] roughly
    # the task's goal, as in its starts; of a stream: exit, inlet and place in the order, as indices
    goal: tuple[float, ...]
    tilt: float = 0.0  # [rad] tilt of the surface, downhill towards `tilt_direction`
    path: NDArray[np.float64] | None = None  # (PATH_POINTS,) [m] y of the path to follow
    tilt_direction: float = 0.0  # [rad] downhill direction, anti-clockwise from +x
    # whether it waits at a stream's gate: since `at`, to enter with this pose and velocity
    waits: bool = False


@dataclass(frozen=True, eq=False)
class Detections:
    """Poses found in a picture, without parcel numbers. Parcels may be missed or wrongly found."""

    taken_at: float  # [s]
    # [m, m, rad] in any order; an angle is known up to turns that leave the base unchanged
    poses: tuple[Triple, ...] = ()


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture of the surface with at most one parcel."""

    taken_at: float  # [s]
    number: int | None = None  # number of the visible parcel; None: no parcel on the surface
    pose: Triple = (0.0, 0.0, 0.0)  # [m, m, rad]; the angle is continuous beyond pi
    axes: Angles | None = None  # encoder angles at that time; None: no encoders


@dataclass(frozen=True)
class AxesAcknowledgement:
    """The device's answer to an axis command."""

    command: int  # the number that `set_axes` returned
    at: float  # [s] when the axes began to turn
    refused: str = ""  # why the device refused the command; empty: accepted


@dataclass(frozen=True)
class ParcelDeparture:
    """Message that a parcel has departed."""

    number: int  # number of the parcel
    outcome: str  # text, e.g. "success"
    metrics: dict[str, float] = field(default_factory=dict)  # the task's metrics, as in `info`


def triple(values: NDArray[np.float64]) -> Triple:
    """Convert a pose or a velocity (3,) to a tuple for a message."""
    first, second, third = values.tolist()
    return (first, second, third)


Message = ParcelEntry | Frame | Detections | AxesAcknowledgement | ParcelDeparture


def to_line(fields: dict[str, Any]) -> bytes:
    """Return the fields of a message as a line of JSON."""
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def from_line(line: bytes) -> dict[str, Any]:
    """Return a message's fields from its line. Raise a ValueError if the line is not JSON."""
    try:
        fields = json.loads(line.decode(), parse_constant=files.refuse_constant)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"line must be JSON, got {line[:80]!r}: {error}") from None
    if not isinstance(fields, dict) or not isinstance(fields.get("kind"), str):
        raise ValueError(f"line must be an object with a kind, got {line[:80]!r}")
    return fields


def to_fields(message: Message) -> dict[str, Any]:
    """Return the fields of a device's message, for `to_line`."""
    if isinstance(message, Frame):
        return {
            "kind": "frame",
            "taken": message.taken_at,
            "number": message.number,
            "pose": list(message.pose),
            "axes": None if message.axes is None else message.axes.tolist(),
        }
    if isinstance(message, Detections):
        poses = [list(pose) for pose in message.poses]
        return {"kind": "detections", "taken": message.taken_at, "poses": poses}
    if isinstance(message, ParcelEntry):
        return {
            "kind": "entered",
            "number": message.number,
            "at": message.at,
            "base": _base_fields(message.parcel.base),
            "mass": message.parcel.mass,
            "com_height": message.parcel.com_height,
            "pose": list(message.pose),
            "velocity": list(message.velocity),
            "goal": list(message.goal),
            "tilt": message.tilt,
            "path": None if message.path is None else message.path.tolist(),
            "tilt_direction": message.tilt_direction,
            **({"waits": True} if message.waits else {}),
        }
    if isinstance(message, AxesAcknowledgement):
        return {
            "kind": "taken",
            "command": message.command,
            "at": message.at,
            "refused": message.refused,
        }
    return {
        "kind": "left",
        "number": message.number,
        "outcome": message.outcome,
        "figures": message.metrics,  # name since the protocol's first version
    }


def from_fields(fields: dict[str, Any], shape: tuple[int, int]) -> Message:
    """Make a device's message from its fields. `shape` (rows, columns) is the shape of commands."""
    kind = checks.one_of("kind", fields["kind"], tuple(_READERS))
    try:
        return _READERS[kind](fields, shape)
    except KeyError as error:
        raise ValueError(f"{kind} must have {error}, got {', '.join(fields)}") from None


def _frame(fields: dict[str, Any], shape: tuple[int, int]) -> Frame:
    number, axes = fields["number"], fields["axes"]
    return Frame(
        taken_at=checks.number("taken", fields["taken"]),
        number=None if number is None else _count("number", number),
        pose=_triple("pose", fields["pose"], checks.pose),
        axes=None if axes is None else numbers("axes", axes, shape),
    )


def _detections(fields: dict[str, Any], _shape: tuple[int, int]) -> Detections:
    poses = fields["poses"]
    if not isinstance(poses, list) or len(poses) > MAX_DETECTIONS:
        raise ValueError(f"poses must be a list of at most {MAX_DETECTIONS}, got {poses!r:.80}")
    return Detections(
        taken_at=checks.number("taken", fields["taken"]),
        poses=tuple(_triple("poses", each, checks.pose) for each in poses),
    )


def _entered(fields: dict[str, Any], _shape: tuple[int, int]) -> ParcelEntry:
    path = fields["path"]
    return ParcelEntry(
        number=_count("number", fields["number"]),
        at=checks.number("at", fields["at"]),
        parcel=Parcel(_base(fields["base"]), mass=fields["mass"], com_height=fields["com_height"]),
        pose=_triple("pose", fields["pose"], checks.pose),
        velocity=_triple("velocity", fields["velocity"], checks.velocity),
        goal=tuple(numbers("goal", fields["goal"], (None,)).tolist()),
        tilt=checks.within("tilt", fields["tilt"], -0.5 * math.pi, 0.5 * math.pi),
        path=None if path is None else numbers("path", path, (None,)),
        tilt_direction=checks.angle("tilt_direction", fields.get("tilt_direction", 0.0)),
        waits=checks.one_of("waits", fields.get("waits", False), (False, True)),
    )


def _acknowledged(fields: dict[str, Any], _shape: tuple[int, int]) -> AxesAcknowledgement:
    return AxesAcknowledgement(
        command=_count("command", fields["command"]),
        at=checks.number("at", fields["at"]),
        refused=text("refused", fields["refused"]),
    )


def _departed(fields: dict[str, Any], _shape: tuple[int, int]) -> ParcelDeparture:
    metrics = fields["figures"]
    if not isinstance(metrics, dict):
        raise ValueError(f"figures must be an object, got {metrics!r}")
    return ParcelDeparture(
        number=_count("number", fields["number"]),
        outcome=text("outcome", fields["outcome"]),
        metrics={name: checks.number(name, value) for name, value in metrics.items()},
    )


_READERS: dict[str, Callable[[dict[str, Any], tuple[int, int]], Message]] = {
    "entered": _entered,
    "frame": _frame,
    "detections": _detections,
    "taken": _acknowledged,
    "left": _departed,
}


def check_message(message: Message, shape: tuple[int, int]) -> None:
    """Raise a ValueError if a device's message lacks values, or has values that are not allowed.

    `shape` is the size of the task's largest zone: its rows and its columns.
    """
    try:
        from_fields(to_fields(message), shape)
    except (TypeError, AttributeError) as error:
        raise ValueError(f"message must have all its values, got {message!r}: {error}") from None


def axes_to_fields(command: int, angles: Angles) -> dict[str, Any]:
    """Return the fields of an axis command from its number and angles (rows, columns) [rad]."""
    return {"kind": "axes", "command": command, "angles": angles.tolist()}


def axes_from_fields(fields: dict[str, Any], shape: tuple[int, int]) -> tuple[int, Angles]:
    """Return an axis command's number and angles [rad]. The angles have `shape` (rows, columns)."""
    checks.one_of("kind", fields["kind"], ("axes",))
    number = _count("command", fields.get("command"))
    return number, numbers("angles", fields.get("angles"), shape)


def gate_to_fields(begin: float, end: float) -> dict[str, Any]:
    """Return the fields of a command to let one parcel in, at a time from `begin` to `end` [s]."""
    return {"kind": "gate", "begin": begin, "end": end}


def gate_from_fields(fields: dict[str, Any]) -> tuple[float, float]:
    """Read a gate command. Return the first and last time [s] at which one parcel may enter."""
    checks.one_of("kind", fields["kind"], ("gate",))
    return checks.number("begin", fields.get("begin")), checks.number("end", fields.get("end"))


def text(name: str, value: Any) -> str:
    """Return `value`. Raise a ValueError if it is no text or longer than `MAX_TEXT` characters."""
    if not isinstance(value, str) or len(value) > MAX_TEXT:
        raise ValueError(f"{name} must be text of at most {MAX_TEXT} characters, got {value!r}")
    return value


def _count(name: str, value: Any) -> int:
    return checks.integer(name, value, least=0, most=MAX_NUMBER)


def numbers(name: str, value: Any, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Return `value` as an array of finite numbers with the shape `shape`.

    If the shape is wrong or an entry is not a finite number, e.g. a boolean, raise a ValueError.
    """
    result = np.array(checks.array(name, value, shape))
    if any(isinstance(each, bool) for each in np.array(value, dtype=object).flat):
        raise ValueError(f"{name} must be an array of numbers, got {value!r}")
    return result


def _triple(name: str, value: Any, check: Callable[..., NDArray[np.float64]]) -> Triple:
    return triple(check(name, numbers(name, value, (3,)), (3,)))


def _base_fields(base: Base) -> dict[str, Any]:
    if isinstance(base, Disc):
        return {"radius": base.radius}
    if isinstance(base, Rectangle):
        return {"length": base.length, "width": base.width}
    return {"corners": (base.outline - np.array(base.centroid)).tolist()}


def _base(fields: Any) -> Base:
    if isinstance(fields, dict):
        if set(fields) == {"radius"}:
            return Disc(fields["radius"])
        if set(fields) == {"length", "width"}:
            return Rectangle(fields["length"], fields["width"])
        if set(fields) == {"corners"}:
            corners = numbers("corners", fields["corners"], (None, 2))
            if len(corners) > MAX_VERTICES:
                raise ValueError(f"corners must be at most {MAX_VERTICES}, got {len(corners)}")
            return Polygon(corners)
    raise ValueError(f"base must have a radius, a length and a width, or corners, got {fields!r}")
