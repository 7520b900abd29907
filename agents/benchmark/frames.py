"""Messages between `PolicyProcess` and its process.

A message is a JSON object with raw arrays. All lengths are limited. Reading a message runs no code
of its sender.
"""

import json
import math
import socket
import struct
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import files

MAX_HEADER = 2**16  # [bytes] of the JSON object
MAX_BODY = 2**26  # [bytes] of the arrays
MAX_ARRAYS = 2
MAX_AXES = 4  # axes of an array
CHUNK = 2**20  # [bytes] read at once
TYPES = (
    "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float16",
    "float32", "float64",
)  # fmt: skip
_PREFIX = struct.Struct("<II")  # lengths of header and body

Message = tuple[dict[str, Any], list[NDArray[Any]]]


def to_frame(fields: Mapping[str, Any], *arrays: NDArray[Any]) -> bytes:
    """Return a message as bytes.

    Raises:
        ValueError: fields are not plain JSON, an array has another type, or the message is too
            long.
        TypeError: a field is an object without a form in JSON.
    """
    for each in arrays:
        if each.dtype.name not in TYPES:
            raise ValueError(f"arrays must be of {', '.join(TYPES)}, got {each.dtype}")
    described = [[each.dtype.name, list(each.shape)] for each in arrays]
    header = json.dumps({"fields": dict(fields), "arrays": described}, allow_nan=False).encode()
    body = b"".join(each.astype(each.dtype.newbyteorder("<")).tobytes() for each in arrays)
    for name, content, most in (("header", header, MAX_HEADER), ("arrays", body, MAX_BODY)):
        if len(content) > most:
            raise ValueError(f"{name} must have at most {most} bytes, got {len(content)}")
    return _PREFIX.pack(len(header), len(body)) + header + body


def read_message(connection: socket.socket, deadline: float = math.inf) -> Message:
    """Read the next message.

    Args:
        connection: socket to the other side.
        deadline: [s] of `time.monotonic()`.

    Raises:
        ValueError: the bytes are no message.
        EOFError: the other side has closed the connection.
        TimeoutError: the message is not complete at the deadline.
    """
    lengths = _PREFIX.unpack(_read(connection, _PREFIX.size, deadline))
    for name, length, most in zip(
        ("header", "arrays"), lengths, (MAX_HEADER, MAX_BODY), strict=True
    ):
        if length > most:
            raise ValueError(f"{name} must have at most {most} bytes, got {length}")
    header, body = (_read(connection, length, deadline) for length in lengths)
    try:
        message = json.loads(header, parse_constant=files.refuse_constant)
        fields, described = message["fields"], message["arrays"]
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise ValueError(f"header must be JSON of a message: {error}") from None
    if not isinstance(fields, dict) or not isinstance(described, list):
        raise ValueError("header must have fields and arrays")
    return fields, _split(body, described)


def send(connection: socket.socket, frame: bytes, deadline: float = math.inf) -> None:
    """Send bytes of `to_frame`; raise a TimeoutError if they are not sent at the deadline."""
    connection.settimeout(_remaining(deadline))
    connection.sendall(frame)


def _split(body: bytes, described: list[Any]) -> list[NDArray[Any]]:
    """Return the arrays of a body, which their types and shapes must use up."""
    if len(described) > MAX_ARRAYS:
        raise ValueError(f"arrays must be at most {MAX_ARRAYS}, got {len(described)}")
    found, first = [], 0
    for each in described:
        if not isinstance(each, list) or len(each) != 2 or each[0] not in TYPES:
            raise ValueError(f"array must have a type and a shape, got {each!r:.60}")
        name, shape = each
        if (
            not isinstance(shape, list)
            or len(shape) > MAX_AXES
            or not all(type(length) is int and 0 <= length <= MAX_BODY for length in shape)
        ):
            raise ValueError(f"shape must be lengths, got {shape!r:.60}")
        kind, count = np.dtype(name).newbyteorder("<"), math.prod(shape)
        end = first + count * kind.itemsize
        if end > len(body):
            raise ValueError(f"arrays must have {end} bytes or more, got {len(body)}")
        values = np.frombuffer(body, kind, count, first).reshape(shape)
        found.append(values.astype(np.dtype(name)))
        first = end
    if first != len(body):
        raise ValueError(f"arrays must have {first} bytes, got {len(body)}")
    return found


def _read(connection: socket.socket, count: int, deadline: float) -> bytes:
    """Read a number of bytes."""
    content = bytearray()
    while len(content) < count:
        connection.settimeout(_remaining(deadline))
        chunk = connection.recv(min(count - len(content), CHUNK))
        if not chunk:
            raise EOFError("the connection is closed")
        content += chunk
    return bytes(content)


def _remaining(deadline: float) -> float | None:
    """Return the time [s] to a deadline; None: any time."""
    if deadline == math.inf:
        return None
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeoutError("the deadline has passed")
    return left
