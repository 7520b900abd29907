"""A policy in a process of its own, with bounded time, memory, files and output.

A policy that loops, ends, starts processes, or writes outside its folder raises a `PolicyFailure`
in the parent process, and leaves no process and no file. Messages are JSON objects with raw arrays
of limited length. Reading a message never executes code from its sender.

The limits guard against accidents and careless code. They are no security sandbox: native code can
do whatever the user can. Run entries of strangers in a container. On macOS, memory and processes
are not watched.
"""

import json
import math
import os
import pickle
import secrets
import shutil
import signal
import site
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks, files
from surface_gym.config import EnvConfig

from .. import library
from .watch import ProcessWatch, adopting_orphans

START_TIME = 120.0  # [s] limit for importing this package in the process
EXIT_TIME = 2.0  # [s] limit for a process to end after it has closed its connection
MAX_REASON = 300  # characters
LEAST_MEMORY = 0.25  # [GiB] memory of this package with its libraries
MOST_TIME = 1e6  # [s]
# Arguments of an environment that a policy may ask for.
ENV_KWARGS = (
    "actions", "control_period", "orientations", "observe", "observe_axes",
    "gate", "max_parcels", "queue",  # of streams
)  # fmt: skip
# Environment variables that the process gets, besides Numba's.
PASSED = ("PATH", "LANG", "LC_ALL", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "TZ")
MARKER = "SURFACE_GYM_POLICY"  # environment variable that marks a policy's processes
ONE_THREAD = ("OMP", "OPENBLAS", "MKL", "VECLIB", "NUMEXPR", "NUMBA")
SOURCES = (
    "FILE.py:Class, a folder with a policy, a model.onnx, a model.zip of Stable-Baselines3, or a "
    "shipped agent"
)


MAX_HEADER = 2**16  # [bytes] of a message's JSON object
MAX_BODY = 2**26  # [bytes] of a message's arrays
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
        ValueError: a field is infinite or NaN, an array's type is not in `TYPES`, or the message is
            too long.
        TypeError: a field is an object that JSON cannot hold.
    """
    for each in arrays:
        if each.dtype.name not in TYPES:
            raise ValueError(f"arrays must be of {', '.join(TYPES)}, got {each.dtype}")
    described = [[each.dtype.name, list(each.shape)] for each in arrays]
    header = json.dumps({"fields": dict(fields), "arrays": described}, allow_nan=False).encode()
    body = b"".join(each.astype(each.dtype.newbyteorder("<")).tobytes() for each in arrays)
    _check_lengths(len(header), len(body))
    return _PREFIX.pack(len(header), len(body)) + header + body


def _check_lengths(header: int, body: int) -> None:
    for name, length, most in (("header", header, MAX_HEADER), ("arrays", body, MAX_BODY)):
        if length > most:
            raise ValueError(f"{name} must have at most {most} bytes, got {length}")


def read_message(connection: socket.socket, deadline: float = math.inf) -> Message:
    """Read the next message: its fields and its arrays.

    Args:
        deadline: [s] time of `time.monotonic()`.

    Raises:
        ValueError: the bytes are no message.
        EOFError: the other side has closed the connection.
        TimeoutError: the message is not complete at the deadline.
    """
    lengths = _PREFIX.unpack(_read(connection, _PREFIX.size, deadline))
    _check_lengths(*lengths)
    header, body = (_read(connection, length, deadline) for length in lengths)
    try:
        message = json.loads(header, parse_constant=files.refuse_constant)
        fields, arrays, first = message["fields"], [], 0
        for name, shape in message["arrays"]:
            kind = np.dtype(TYPES[TYPES.index(name)])
            if not all(type(length) is int and length >= 0 for length in shape):
                raise ValueError(f"shape must be lengths, got {shape!r:.60}")
            count = math.prod(shape)
            found = np.frombuffer(body, kind.newbyteorder("<"), count, first)
            arrays.append(found.reshape(shape).astype(kind))
            first += found.nbytes
    except (ValueError, LookupError, TypeError, ArithmeticError, RecursionError) as error:
        raise ValueError(f"header must be JSON of a message: {error}") from None
    if not isinstance(fields, dict) or first != len(body):
        raise ValueError(f"message must have fields and arrays of {first} bytes, got {len(body)}")
    return fields, arrays


def _read(connection: socket.socket, count: int, deadline: float) -> bytes:
    """Read `count` bytes; raise a TimeoutError at the deadline [s] of `time.monotonic`."""
    content = bytearray()
    while len(content) < count:
        _set_timeout(connection, deadline)
        chunk = connection.recv(min(count - len(content), CHUNK))
        if not chunk:
            raise EOFError("the connection is closed")
        content += chunk
    return bytes(content)


def send(connection: socket.socket, frame: bytes, deadline: float = math.inf) -> None:
    """Send a frame. If sending is not over at the time `deadline` [s], raise a TimeoutError."""
    _set_timeout(connection, deadline)
    connection.sendall(frame)


def _set_timeout(connection: socket.socket, deadline: float) -> None:
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeoutError("the deadline has passed")
    connection.settimeout(None if left == math.inf else left)


class PolicyFailure(Exception):
    """A policy failed; the text is the reason in one line, e.g. "took more than 60 s to decide"."""


@dataclass(frozen=True)
class PolicyLimits:
    """Limits of a policy's process.

    Raises:
        ValueError: a limit is out of bounds.
    """

    memory: float = 4.0  # [GiB] of the process
    seconds: float = 60.0  # [s] of all decisions since `begin`, by the clock
    begin: float = 60.0  # [s] for loading the policy, and for each `begin`

    def __post_init__(self) -> None:
        checks.settle(
            self,
            memory=(checks.positive, LEAST_MEMORY, 1024.0),
            seconds=(checks.positive, 0.0, MOST_TIME),
            begin=(checks.positive, 0.0, MOST_TIME),
        )


def read_source(source: str | Path) -> tuple[str, Path, str]:
    """Return kind, path and class name of a policy's source, without loading the policy.

    Raises:
        ValueError: the source is not of a known kind, or does not exist.
    """
    text = str(checks.path("policy", source))
    if text in library.names():
        seed = library.seeds(text)[0]
        return "package", library.SHELF / text / f"seed-{seed}", ""
    file, colon, name = text.rpartition(":")
    path = Path(file if colon and file.endswith(".py") else text).resolve()
    if path.is_dir():
        return "package", path, ""
    kind = {".py": "python", ".onnx": "onnx", ".zip": "zip"}.get(path.suffix)
    if kind is None or not path.is_file() or (kind == "python") != name.isidentifier():
        raise ValueError(f"policy must be {SOURCES}, got {text!r}")
    return kind, path, name if kind == "python" else ""


class PolicyProcess:
    """A policy in its own process. It is a context manager and, after `begin`, a `Controller`.

    Args:
        source: FILE.py:Class, a folder with a policy of this package, a model.onnx, a model.zip of
            Stable-Baselines3, or the name of a shipped agent. `Class` is called with an `EnvConfig`
            and a seed, and has the method `predict` of `Controller`. The optional attribute
            `Class.env_kwargs` is a dictionary, or a function of two names: a task and a preset.

    Raises:
        ValueError: the source is not of a known kind, or the system is Windows.
    """

    def __init__(self, source: str | Path, limits: PolicyLimits | None = None) -> None:
        if sys.platform == "win32":
            raise ValueError("system must be Linux or macOS for a policy's process, got Windows")
        self.limits = PolicyLimits() if limits is None else limits
        self._source = read_source(source)
        self._open = ExitStack()
        self._watch: ProcessWatch | None = None
        self._failure: str | None = None
        self._config: EnvConfig | None = None
        self._left = 0.0  # [s] for decisions
        self._token: int | None = None  # in place of the policy's last state

    def __enter__(self) -> "PolicyProcess":
        """Start the process; the policy is not loaded yet.

        On Linux, the process also ends when the thread that called this method ends.
        """
        try:
            watch = self._start()
            self._receive(time.monotonic() + START_TIME, START_TIME, "to start")
            watch.allows_children = False
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process with all its children, and delete its files."""
        self._open.close()

    def env_kwargs(self, task: str, preset: str | None = None) -> dict[str, Any]:
        """Load the policy; return the `EnvConfig` arguments that it requests for task and preset.

        Raises:
            PolicyFailure: the policy failed, or asked for an argument that is not allowed.
        """
        request = {"kind": "env_kwargs", "task": task, "preset": preset}
        fields, _ = self._ask(to_frame(request), self.limits.begin, "to load")
        asked = fields.get("asked")
        if not isinstance(asked, dict):
            raise self._fail("sent a message that is not allowed")
        unknown = [name for name in asked if name not in ENV_KWARGS]
        if unknown:
            allowed = ", ".join(ENV_KWARGS)
            raise self._fail(f"asked for env_kwargs {unknown[0]!r}, allowed are {allowed}")
        try:
            EnvConfig(task, preset=preset, **asked)
        except (ValueError, TypeError) as error:
            raise self._fail(f"asked for env_kwargs that are not allowed: {error}") from None
        return asked

    def begin(self, arguments: Mapping[str, Any], seed: int) -> None:
        """Create the policy anew for an environment, and set the used decision time to 0.

        Args:
            arguments: keyword arguments of `EnvConfig`, e.g. `task`, `preset` and the policy's
                `env_kwargs`. They are pickled for the process.

        Raises:
            PolicyFailure: the policy failed.
            ValueError: an argument of `EnvConfig` is not allowed.
        """
        self._config = EnvConfig(**arguments)
        self._token, self._left = None, self.limits.seconds
        packed = np.frombuffer(pickle.dumps(dict(arguments)), dtype=np.uint8)
        request = {"kind": "begin", "seed": checks.integer("seed", seed, least=0)}
        self._ask(to_frame(request, packed), self.limits.begin, "to begin")

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: ArrayLike | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Choose actions by the policy; see `Controller`.

        The policy's state stays in its process. The returned state is a token for the next call.

        Raises:
            PolicyFailure: the policy failed, or its actions are not allowed.
            ValueError: `begin` was not called, or `state` is not the latest token.
        """
        if self._config is None:
            raise ValueError("begin must be called before predict")
        if state is not None and state != self._token:
            raise ValueError(f"state must be the last that predict returned, got {state!r}")
        fields = {
            "kind": "predict", "state": state is not None, "deterministic": bool(deterministic),
        }  # fmt: skip
        arrays = [np.asarray(observation)]
        if episode_start is not None:
            arrays.append(np.asarray(episode_start, dtype=np.uint8))
        since = time.monotonic()
        answer, found = self._ask(to_frame(fields, *arrays), self._left, "to decide")
        self._left -= time.monotonic() - since
        if len(found) != 1 or not isinstance(answer.get("state"), bool):
            raise self._fail("sent a message that is not allowed")
        is_one = arrays[0].ndim == len(self._config.observation_space().shape)
        try:
            self._config.action_kind.commands(found[0], None if is_one else len(arrays[0]))
        except ValueError as error:
            raise self._fail(f"returned actions that are not allowed: {error}") from None
        self._token = (self._token or 0) + 1
        return found[0], self._token if answer["state"] else None

    @property
    def decided(self) -> float:
        """[s] time of all decisions since `begin`."""
        return self.limits.seconds - self._left

    def _start(self) -> ProcessWatch:
        """Start the process, and its watch."""
        if self._watch is not None:
            raise ValueError("a process must be started once, got a second time")
        folder = Path(tempfile.mkdtemp(prefix="surface-gym-policy-")).resolve()
        self._open.callback(remove_folder, folder)
        self._open.enter_context(adopting_orphans())
        self._connection, theirs = socket.socketpair()
        self._open.enter_context(self._connection)
        marker = secrets.token_hex(16)
        memory = int(self.limits.memory * 2**30)
        kind, path, name = self._source
        output, writing = os.pipe()
        with theirs:
            process = subprocess.Popen(
                [
                    sys.executable, "-m", f"{__package__}.worker", str(theirs.fileno()),
                    str(memory), kind, str(path), name,
                ],
                cwd=folder,
                env=make_environment(folder, marker),
                stdin=subprocess.DEVNULL,
                stdout=writing,
                stderr=writing,
                start_new_session=True,
                pass_fds=(theirs.fileno(),),
            )  # fmt: skip
        os.close(writing)
        self._process = process
        watch = ProcessWatch(process, output, folder, memory, marker.encode())
        self._open.callback(watch.finish)
        watch.start()
        self._watch = watch
        return watch

    def _ask(self, frame: bytes, seconds: float, purpose: str) -> Message:
        """Send a request, and return the answer.

        If there is no answer within `seconds` [s], raise a PolicyFailure. `purpose` ends the
        error's text, e.g. "to load".
        """
        if self._failure is not None:
            raise PolicyFailure(self._failure)
        if self._watch is None:
            raise ValueError("the policy's process must be started by `with`, got none")
        deadline = time.monotonic() + seconds
        with suppress(OSError):  # the answer says why
            send(self._connection, frame, deadline)
        return self._receive(deadline, seconds, purpose)

    def _receive(self, deadline: float, seconds: float, purpose: str) -> Message:
        """Return the next message. If no valid message comes in time, raise a PolicyFailure."""
        try:
            fields, arrays = read_message(self._connection, deadline)
        except TimeoutError:
            limit = self.limits.seconds if purpose == "to decide" else seconds
            raise self._fail(f"took more than {limit:g} s {purpose}") from None
        except ValueError:
            raise self._fail("sent a message that is not allowed") from None
        except (EOFError, OSError):
            raise self._fail(self._describe_end()) from None
        except BaseException:  # an interrupt ends the process, too
            self.close()
            raise
        if fields.get("kind") in ("denied", "failed"):
            memory = f"used more than {self.limits.memory:g} GiB of memory"
            raise self._fail(memory if fields.get("memory") else str(fields.get("reason")))
        return fields, arrays

    def _describe_end(self) -> str:
        """Return why the process ended."""
        assert self._watch is not None
        try:
            code = self._process.wait(EXIT_TIME)
        except subprocess.TimeoutExpired:
            return "closed its connection"
        if code < 0:
            known = signal.strsignal(-code) or "unknown"
            end = f"ended with signal {-code} ({known})"
        else:
            end = f"ended with exit code {code}"
        line = self._watch.last_line()
        return f"{end}: {line}" if line else end

    def _fail(self, reason: str) -> PolicyFailure:
        """End the process, and return the failure.

        If a `ProcessWatch` ended the process, the failure names the exceeded limit, not `reason`.
        """
        assert self._watch is not None
        self._failure = one_line(self._watch.reason or reason)
        self.close()
        return PolicyFailure(self._failure)


def make_environment(folder: Path, marker: str) -> dict[str, str]:
    """Return the environment variables of a policy's process. `marker` is unique to the process."""
    passed = {
        name: value
        for name, value in os.environ.items()
        if name in PASSED or name.startswith("NUMBA_")
    }
    return {
        **passed,
        **dict.fromkeys(("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"), str(folder)),
        **{f"{name}_NUM_THREADS": "1" for name in ONE_THREAD},
        "CUDA_VISIBLE_DEVICES": "",  # its memory is not limited
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONHASHSEED": "0",
        "PYTHONPATH": os.pathsep.join(str(Path(each).resolve()) for each in sys.path),
        "PYTHONSAFEPATH": "1",
        "PYTHONUNBUFFERED": "1",
        "PYTHONUSERBASE": site.getuserbase(),
        MARKER: marker,
    }


def one_line(text: str) -> str:
    """Return a text of a process as one line of printable characters."""
    words = "".join(each if each.isprintable() else " " for each in text).split()
    line = " ".join(words) or "failed without a reason"
    return line if len(line) <= MAX_REASON else f"{line[:MAX_REASON]}..."


def remove_folder(folder: Path) -> None:
    """Delete a folder with all its files, even if folders are not writable."""
    os.chmod(folder, 0o700)
    for place, folders, _ in os.walk(folder):
        for each in (os.path.join(place, name) for name in folders):
            if not os.path.islink(each):
                os.chmod(each, 0o700)
    shutil.rmtree(folder, ignore_errors=True)
