"""What goes over the socket: a line of JSON a message, read strictly. Reading runs no code.

A line is an object with a `kind`, "hello", "entered", "frame", "taken" or "left" from the device
and "axes" to it; times are [s] by `time.monotonic()` of the machine, which both processes share.
"""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle

from .device import Angles, AxesTaken, Entered, Frame, Left, Message

PROTOCOL = 1  # its version, which both sides must be of
LONGEST = 1_000_000  # [bytes] of a line


def line_of(fields: dict[str, Any]) -> bytes:
    """A message as a line.

    Raises:
        ValueError: a number that is not finite.
    """
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def fields_of(line: bytes) -> dict[str, Any]:
    """A line as a message.

    Raises:
        ValueError: it is none.
    """
    try:
        fields = json.loads(line, parse_constant=_no_number)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"line must be JSON, got {line[:80]!r}: {error}") from None
    if not isinstance(fields, dict) or not isinstance(fields.get("kind"), str):
        raise ValueError(f"line must be an object with a kind, got {line[:80]!r}")
    return fields


def _no_number(name: str) -> None:
    raise ValueError(f"numbers must be finite, got {name}")


def hello(task: str, shape: tuple[int, int]) -> dict[str, Any]:
    """What a device says first: its version of all this, its task, its widest zone."""
    return {"kind": "hello", "protocol": PROTOCOL, "task": task, "zone": list(shape)}


def fields_of_message(message: Message) -> dict[str, Any]:
    """What a device says, as a message to send."""
    if isinstance(message, Frame):
        return {
            "kind": "frame",
            "taken": message.taken,
            "number": message.number,
            "pose": list(message.pose),
            "axes": None if message.axes is None else message.axes.tolist(),
        }
    if isinstance(message, Entered):
        return {
            "kind": "entered",
            "number": message.number,
            "at": message.at,
            "base": _fields_of_base(message.parcel.base),
            "mass": message.parcel.mass,
            "com_height": message.parcel.com_height,
            "pose": list(message.pose),
            "velocity": list(message.velocity),
            "goal": list(message.goal),
            "tilt": message.tilt,
            "path": None if message.path is None else message.path.tolist(),
        }
    if isinstance(message, AxesTaken):
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
        "figures": message.figures,
    }


def message_of(fields: dict[str, Any], shape: tuple[int, int]) -> Message:
    """What a device says, from a message; `shape` is (rows, columns) of the widest zone.

    Raises:
        ValueError: it is nothing that a device says, or a field is missing or not allowed.
    """
    kind = checks.one_of("kind", fields["kind"], tuple(_READERS))
    try:
        return _READERS[kind](fields, shape)
    except KeyError as error:
        raise ValueError(f"{kind} must have {error}, got {', '.join(fields)}") from None


def _frame(fields: dict[str, Any], shape: tuple[int, int]) -> Frame:
    number, axes = fields["number"], fields["axes"]
    return Frame(
        taken=checks.number("taken", fields["taken"]),
        number=None if number is None else checks.integer("number", number, least=0),
        pose=_triple("pose", fields["pose"]),
        axes=None if axes is None else np.array(checks.array("axes", axes, shape)),
    )


def _entered(fields: dict[str, Any], shape: tuple[int, int]) -> Entered:
    del shape
    path = fields["path"]
    return Entered(
        number=checks.integer("number", fields["number"], least=0),
        at=checks.number("at", fields["at"]),
        parcel=Parcel(_base(fields["base"]), mass=fields["mass"], com_height=fields["com_height"]),
        pose=_triple("pose", fields["pose"]),
        velocity=_triple("velocity", fields["velocity"]),
        goal=tuple(checks.array("goal", np.array(fields["goal"], float), (None,)).tolist()),
        tilt=checks.within("tilt", fields["tilt"], -0.5 * math.pi, 0.5 * math.pi),
        path=None if path is None else checks.array("path", path, (None,)),
    )


def _taken(fields: dict[str, Any], shape: tuple[int, int]) -> AxesTaken:
    del shape
    return AxesTaken(
        command=checks.integer("command", fields["command"], least=0),
        at=checks.number("at", fields["at"]),
        refused=_words("refused", fields["refused"]),
    )


def _left(fields: dict[str, Any], shape: tuple[int, int]) -> Left:
    del shape
    figures = fields["figures"]
    if not isinstance(figures, dict):
        raise ValueError(f"figures must be an object, got {figures!r}")
    return Left(
        number=checks.integer("number", fields["number"], least=0),
        outcome=_words("outcome", fields["outcome"]),
        figures={name: checks.number(name, value) for name, value in figures.items()},
    )


_READERS: dict[str, Callable[[dict[str, Any], tuple[int, int]], Message]] = {
    "entered": _entered,
    "frame": _frame,
    "taken": _taken,
    "left": _left,
}


def axes_fields(command: int, angles: Angles) -> dict[str, Any]:
    """A command to turn axes, as a message to send."""
    return {"kind": "axes", "command": command, "angles": angles.tolist()}


def axes_of(fields: dict[str, Any], shape: tuple[int, int]) -> tuple[int, Angles]:
    """The number of a command and its angles (rows, columns) [rad], whatever they are.

    Raises:
        ValueError: it is no such message.
    """
    checks.one_of("kind", fields["kind"], ("axes",))
    number = checks.integer("command", fields.get("command"), least=0)
    return number, np.array(checks.array("angles", fields.get("angles"), shape))


def _words(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name} must be words, got {value!r}")
    return value


def _triple(name: str, value: Any) -> tuple[float, float, float]:
    first, second, third = checks.array(name, value, (3,)).tolist()
    return (first, second, third)


def _fields_of_base(base: Base) -> dict[str, Any]:
    """A base around its centroid: of a disc its radius, of any other its corners."""
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
            return Polygon(fields["corners"])
    raise ValueError(f"base must have a radius, a length and a width, or corners, got {fields!r}")
