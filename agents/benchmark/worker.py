"""The process of a policy: it loads the policy, and answers the requests of `PolicyProcess`.

Only `PolicyProcess` starts `python -m surface_gym.agents.benchmark.worker`. A policy is a class in
a Python file, a policy of this package, an ONNX model, or a zip file of Stable-Baselines3. Loading
a Python file or a zip file may execute code.

Before it loads the policy, the process sets its own limits. Resource limits bound memory, files and
core dumps. A Python audit hook refuses to write outside a folder, to start processes and to open
connections; it reports refused calls. Code that calls the system without Python, e.g. by ctypes,
bypasses the hook.
"""

import errno
import importlib.util
import json
import os
import pickle
import platform
import socket
import sys
import threading
import traceback
import zipfile
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.files import read_bytes

from .. import library
from ..base import Singles
from .process import TYPES, read_message, send, to_frame

READY, DENIED, FAILED = "ready", "denied", "failed"  # kinds of messages
MAX_TEXT = 1000  # characters of a reason
FILE_SIZE = 2**26  # [bytes] of each file
OPEN_FILES = 256
PARENT_DEATH = 1  # option of prctl: a signal at the parent's end
KILL = 9

# Events that write: whether the call follows a link at a path's end, and which of its arguments are
# a path and the descriptor of the path's folder.
_WRITES: dict[str, tuple[bool, tuple[tuple[int, int | None], ...]]] = {
    "os.link": (False, ((0, 2), (1, 3))),
    "os.mkdir": (False, ((0, 2),)),
    "os.remove": (False, ((0, 1),)),
    "os.rename": (False, ((0, 2), (1, 3))),
    "os.rmdir": (False, ((0, 1),)),
    "os.symlink": (False, ((1, 2),)),
    "os.chflags": (True, ((0, None),)),
    "os.chmod": (True, ((0, 2),)),
    "os.chown": (True, ((0, 3),)),
    "os.removexattr": (True, ((0, None),)),
    "os.setxattr": (True, ((0, None),)),
    "os.truncate": (True, ((0, None),)),
    "os.utime": (True, ((0, 3),)),
    "sqlite3.connect": (True, ((0, None),)),
}
_REFUSED = {
    **dict.fromkeys(
        (
            "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.system",
            "pty.spawn", "subprocess.Popen",
        ),
        "started a process",
    ),
    **dict.fromkeys(
        (
            "socket.bind", "socket.connect", "socket.getaddrinfo", "socket.gethostbyaddr",
            "socket.gethostbyname", "socket.sendmsg", "socket.sendto",
        ),
        "used the network",
    ),
    **dict.fromkeys(("resource.prlimit", "resource.setrlimit"), "changed its limits"),
}  # fmt: skip
_PROGRAMS = ("os.exec", "os.posix_spawn", "os.spawn", "os.system", "subprocess.Popen")
_SIGNALS = ("os.kill", "os.killpg")
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_UNNAMED = getattr(os, "O_TMPFILE", 0)  # a file without a name, which leaves nothing
_COMPILED = "__pycache__"
# Modules that start programs to look something up, and go on without.
_CURIOUS = ("ctypes.util", "matplotlib.font_manager", "platform", "uuid")
_DEPTH = 20  # stack frames searched for these modules


def set_limits(memory: int) -> None:
    """Limit the resources of this process. On Linux, also end this process when its parent ends.

    `memory` [bytes] is the limit of private memory.
    """
    import resource

    for name, value in (
        ("RLIMIT_CORE", 0), ("RLIMIT_DATA", memory), ("RLIMIT_FSIZE", FILE_SIZE),
        ("RLIMIT_NOFILE", OPEN_FILES),
    ):  # fmt: skip
        kind = getattr(resource, name)
        hard = resource.getrlimit(kind)[1]
        most = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (most, most))
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(PARENT_DEATH, KILL, 0, 0, 0)


def confine(folder: str, caches: tuple[str, ...], report: Callable[[str], None]) -> None:
    """From now on, refuse writes outside `folder`, new processes, new connections and signals.

    A refused call raises a PermissionError. A refused write to a cache of compiled code is not
    reported, because libraries also work without a cache.

    Args:
        folder: absolute path without links.
        caches: absolute paths, without links, of further folders with compiled code.
        report: called with a description of the refused call, e.g. "wrote to /home/x".
    """
    # Names of the module could be replaced by the policy by mistake.
    writes, refused, own = _WRITES, _REFUSED, os.getpid()

    def refuse(reason: str, is_reported: bool = True) -> None:
        if is_reported:
            report(reason)
        raise PermissionError(errno.EACCES, f"a policy must not do this: it {reason}")

    def is_cache(place: str) -> bool:
        return _COMPILED in place.split(os.sep) or any(_is_inside(place, x) for x in caches)

    def check_place(event: str, place: str) -> None:
        if place == os.devnull or _is_inside(place, folder) or place == ":memory:":
            return
        if event == "os.mkdir" and os.path.isdir(place):
            return  # the call raises FileExistsError
        refuse(f"wrote to {place}", not is_cache(place))

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = arguments
            if isinstance(flags, int) and flags & _WRITING and not isinstance(path, int):
                place = _find_place(path, -1, True)
                # A folder itself cannot be written: Numba looks whether a file could be.
                is_unnamed = _UNNAMED != 0 and flags & _UNNAMED == _UNNAMED
                if not os.path.isdir(place) or (is_unnamed and not is_cache(place)):
                    check_place(event, place)
        elif event in refused:
            program = f": {arguments[0]}" if event in _PROGRAMS else ""
            refuse(refused[event] + program, not (event in _PROGRAMS and _is_curious()))
        elif event in writes:
            is_followed, places = writes[event]
            for path, descriptor in places:
                inside = -1 if descriptor is None else arguments[descriptor]
                check_place(event, _find_place(arguments[path], inside, is_followed))
        elif event in _SIGNALS and arguments[0] not in (0, own):
            refuse("sent a signal to another process")

    sys.addaudithook(hook)


def _find_place(path: Any, descriptor: int, is_followed: bool) -> str:
    """Return the absolute path of `path`, an argument of a system call, without symbolic links.

    A relative path begins at the folder with the file descriptor `descriptor`. If `descriptor` is
    negative, a relative path begins at the working folder. If `is_followed` is false, a link at the
    path's end stays unresolved.
    """
    if isinstance(path, int):
        return os.path.realpath(f"/dev/fd/{path}")
    name = os.fsdecode(path)
    if name == ":memory:":
        return name
    if descriptor >= 0:
        name = os.path.join(os.path.realpath(f"/dev/fd/{descriptor}"), name)
    above, last = os.path.split(name)
    if is_followed or last in ("", os.curdir, os.pardir):
        return os.path.realpath(name)
    return os.path.join(os.path.realpath(above), last)


def _is_inside(place: str, folder: str) -> bool:
    return place == folder or place.startswith(folder + os.sep)


def _is_curious() -> bool:
    """Return whether a library in `_CURIOUS` is among the callers.

    These libraries start a program to get information. They also work without the program.
    """
    frame, depth = sys._getframe(), 0
    while frame.f_back is not None and depth < _DEPTH:
        frame, depth = frame.f_back, depth + 1
        if frame.f_globals.get("__name__") in _CURIOUS:
            return True
    return False


MODULE = "benchmarked_policy"  # name of a file's module in the policy's process
MAX_MODEL = 2**28  # [bytes] of an ONNX file or of the description in a zip file
# Fields of Stable-Baselines3's files that only one algorithm has; DDPG is a kind of TD3.
ZIP_ALGORITHMS = {
    "clip_range": "PPO",
    "exploration_fraction": "DQN",
    "policy_delay": "TD3",
    "target_entropy": "SAC",
    "gae_lambda": "A2C",  # PPO has it, too
}
ONNX_TEXTS = ("actions", "control_period", "orientations", "observe")  # arguments in the metadata


class PolicySource(NamedTuple):
    """A policy loaded from a file. `make` creates the policy's controller for an environment."""

    env_kwargs: Callable[[str, str | None], Any]  # arguments that it asks for a task and a preset
    make: Callable[[EnvConfig, int], Any]  # a `Controller` for a configuration and a seed


def read_python(file: Path, name: str) -> PolicySource:
    """Read a policy's class from a Python file.

    The class is called with an `EnvConfig` and a seed. Its attribute `env_kwargs` is a dictionary,
    or a function of the names of a task and a preset. The file may import modules of its folder.
    """
    sys.path.append(str(file.parent))
    spec = importlib.util.spec_from_file_location(MODULE, file)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[MODULE] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: Any = getattr(module, name, None)
    if not callable(found):
        raise ValueError(f"{file.name} must have a class {name}, got none")

    def env_kwargs(task: str, preset: str | None) -> Any:
        asked = getattr(found, "env_kwargs", {})
        return asked(task, preset) if callable(asked) else asked

    return PolicySource(env_kwargs, found)


def read_package(folder: Path, _: str) -> PolicySource:
    """Read a policy of this package from its folder."""
    files = library.read_files(folder)
    card = library.read_card(files)

    def env_kwargs(task: str, _: str | None) -> Any:
        checks.one_of("task", library.card_env_id(task), (card.env_id,))
        return card.env_kwargs

    def make(config: EnvConfig, _: int) -> Any:
        options = library.ALGORITHMS.find(card.algo).build_options or ()
        return library.from_files(files, None, config if "config" in options else None)

    return PolicySource(env_kwargs, make)


def read_onnx(file: Path, _: str) -> PolicySource:
    """Read an ONNX model, which runs on one core.

    If `surface-gym export` wrote the model, the model's metadata describe the environment.
    """
    onnxruntime: Any = import_module("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        read_bytes(file, MAX_MODEL), options, providers=["CPUExecutionProvider"]
    )
    found = session.get_modelmeta().custom_metadata_map

    def env_kwargs(task: str, _: str | None) -> Any:
        asked = library.card_env_id(task)
        checks.one_of("task", asked, (found.get("task", asked),))
        return {
            name: found[name] if name == "actions" else json.loads(found[name])
            for name in ONNX_TEXTS
            if name in found
        }

    def make(config: EnvConfig, _: int) -> Any:
        if "features" in found:
            shown = [each.name for each in config.features]
            checks.one_of("features", json.dumps(shown), (found["features"],))
        return OnnxController(session, config)

    return PolicySource(env_kwargs, make)


class OnnxController:
    """A controller without memory that runs an ONNX model.

    The model's input is the observation. A model of `surface-gym export` has the output "choices".
    The first output of any other model is the action.
    """

    def __init__(self, session: Any, config: EnvConfig) -> None:
        self._session, self._kind = session, config.action_kind
        self._axes = len(config.observation_space().shape)
        (self._input,) = [each.name for each in session.get_inputs()]
        outputs = [each.name for each in session.get_outputs()]
        self._encodes = "choices" in outputs
        self._output = "choices" if self._encodes else outputs[0]

    def predict(self, observation: Singles, state: Any = None, *_: Any, **__: Any) -> Any:
        """Choose actions; see `Controller`."""
        is_one = observation.ndim == self._axes
        batch = observation[np.newaxis] if is_one else observation
        (found,) = self._session.run([self._output], {self._input: batch})
        actions = self._kind.encode(found) if self._encodes else found
        return (actions[0] if is_one else actions), state


def read_zip(file: Path, _: str) -> PolicySource:
    """Read a model saved by Stable-Baselines3: PPO, A2C, DQN, SAC or TD3."""
    import stable_baselines3

    with zipfile.ZipFile(file) as archive:
        entry = archive.getinfo("data")
        if entry.file_size > MAX_MODEL:
            raise ValueError(f"data must have at most {MAX_MODEL} bytes, got {entry.file_size}")
        fields = json.loads(archive.read(entry))
    known = [name for field, name in ZIP_ALGORITHMS.items() if field in fields]
    if not known:
        raise ValueError(f"{file.name} must hold {', '.join(ZIP_ALGORITHMS.values())}, got none")
    # Schedules are code of the Python that wrote them; decisions do without.
    schedules = {"learning_rate": 0.0, "lr_schedule": None, "clip_range": 0.0}
    algorithm = getattr(stable_baselines3, known[0])
    model = algorithm.load(file, device="cpu", custom_objects=schedules)

    def make(config: EnvConfig, seed: int) -> Any:
        own, wanted = model.observation_space, config.observation_space()
        checks.one_of("features", own.shape, (wanted.shape,))
        model.set_random_seed(seed)
        return model

    return PolicySource(lambda *_: {}, make)


# Functions of the path and the name of a class.
SOURCES: dict[str, Callable[[Path, str], PolicySource]] = {
    "python": read_python, "package": read_package, "onnx": read_onnx, "zip": read_zip,
}  # fmt: skip


class Worker:
    """The part of a policy's process that answers requests.

    `source` is a tuple of three names: the policy's kind, path and class.
    """

    def __init__(self, connection: socket.socket, source: tuple[str, str, str]) -> None:
        self._connection = connection
        self._described = source
        self._policy: Any = None
        self._state: Any = None
        self._sending = threading.Lock()
        self._is_denied = False

    def deny(self, reason: str) -> None:
        """Report the first forbidden call at once, before the policy can exit or hide the error."""
        if not self._is_denied:
            self._is_denied = True
            self._send(to_frame({"kind": DENIED, "reason": reason[:MAX_TEXT]}))

    def run(self) -> None:
        """Answer requests until the parent closes the connection."""
        self._send(to_frame({"kind": READY}))
        requests = {
            "env_kwargs": self._env_kwargs, "begin": self._begin, "predict": self._predict,
        }  # fmt: skip
        while True:
            try:
                fields, arrays = read_message(self._connection)
            except (EOFError, OSError):
                return
            try:
                answer, found = requests[fields["kind"]](fields, arrays)
                frame = to_frame(answer, *found)
            except MemoryError:
                frame = to_frame({"kind": FAILED, "memory": True})
            except BaseException as error:
                frame = to_frame({"kind": FAILED, "reason": describe(error)})
            self._send(frame)

    def _send(self, frame: bytes) -> None:
        with self._sending:
            send(self._connection, frame)

    @cached_property
    def _source(self) -> PolicySource:
        kind, path, name = self._described
        return SOURCES[kind](Path(path), name)

    def _env_kwargs(self, fields: dict[str, Any], _: Any) -> Any:
        asked = self._source.env_kwargs(fields["task"], fields["preset"])
        try:
            text = json.dumps(dict(asked), allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise AnswerError(f"asked for env_kwargs that are not JSON: {error}") from None
        return {"kind": "env_kwargs", "asked": json.loads(text)}, ()

    def _begin(self, fields: dict[str, Any], arrays: Any) -> Any:
        config = EnvConfig(**pickle.loads(arrays[0].tobytes()))
        self._policy = self._state = None
        self._policy = self._source.make(config, fields["seed"])
        if not callable(getattr(self._policy, "predict", None)):
            raise AnswerError(f"must have a method predict, got {type(self._policy).__name__}")
        return {"kind": "begun"}, ()

    def _predict(self, fields: dict[str, Any], arrays: Any) -> Any:
        observation, *starts = arrays
        begun = starts[0].astype(np.bool_) if starts else None
        state = self._state if fields["state"] else None
        given = self._policy.predict(
            observation, state, begun, deterministic=fields["deterministic"]
        )
        if not isinstance(given, tuple) or len(given) != 2:
            kind = type(given).__name__
            raise AnswerError(f"returned {kind} from predict, allowed (actions, state)")
        try:
            actions = np.asarray(given[0])
        except ValueError:
            raise AnswerError("returned actions that are not an array") from None
        if actions.dtype.name not in TYPES:
            raise AnswerError(f"returned actions of {actions.dtype}, allowed numbers")
        self._state = given[1]
        return {"kind": "actions", "state": self._state is not None}, (actions,)


class AnswerError(Exception):
    """A policy's answer is not allowed; the message is the reason."""


def describe(error: BaseException) -> str:
    """Describe an error, with the line of the policy's file that caused it."""
    if isinstance(error, AnswerError):
        return str(error)[:MAX_TEXT]
    try:
        text = str(error)[:MAX_TEXT]
    except Exception:
        text = "an error without text"
    module = sys.modules.get(MODULE)
    file = getattr(module, "__file__", None)
    lines = [
        each.lineno
        for each in traceback.extract_tb(error.__traceback__)
        if file is not None and each.filename == file
    ]
    place = f" in line {lines[-1]} of {Path(str(file)).name}" if lines else ""
    return f"raised {type(error).__name__}{place}: {text}"


def main() -> None:
    """Run the process of a policy."""
    descriptor, memory, kind, path, name = sys.argv[1:]
    set_limits(int(memory))
    platform.processor()  # starts a program the first time
    connection = socket.socket(fileno=int(descriptor))
    worker = Worker(connection, (kind, path, name))
    caches = tuple(filter(None, [os.environ.get("NUMBA_CACHE_DIR")]))
    confine(os.getcwd(), caches, worker.deny)
    worker.run()
    os._exit(0)


if __name__ == "__main__":
    main()
