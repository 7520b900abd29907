"""The process of a policy: it loads the policy, and answers the requests of `PolicyProcess`.

`python -m surface_gym.agents.benchmark.worker` is started by `PolicyProcess` only.
"""

import json
import os
import pickle
import platform
import socket
import sys
import threading
import traceback
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym.config import EnvConfig

from .confinement import confine, set_limits
from .frames import TYPES, read_message, send, to_frame
from .sources import MODULE, PolicySource, find_source

READY, DENIED, FAILED = "ready", "denied", "failed"  # kinds of messages
MAX_TEXT = 1000  # characters of a reason


class Worker:
    """Answers of a policy's process to requests.

    Args:
        connection: socket to the parent.
        source: kind, path and class of the policy.
    """

    def __init__(self, connection: socket.socket, source: tuple[str, str, str]) -> None:
        self._connection = connection
        self._described = source
        self._source: PolicySource | None = None
        self._policy: Any = None
        self._state: Any = None
        self._sending = threading.Lock()
        self._is_denied = False

    def deny(self, reason: str) -> None:
        """Report the first refused call at once, since the policy may hide it or end."""
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

    def _find_source(self) -> PolicySource:
        if self._source is None:
            self._source = find_source(*self._described)
        return self._source

    def _env_kwargs(self, fields: dict[str, Any], _: Any) -> Any:
        asked = self._find_source().env_kwargs(fields["task"], fields["preset"])
        try:
            text = json.dumps(dict(asked), allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise AnswerError(f"asked for env_kwargs that are not JSON: {error}") from None
        return {"kind": "env_kwargs", "asked": json.loads(text)}, ()

    def _begin(self, fields: dict[str, Any], arrays: Any) -> Any:
        config = EnvConfig(**pickle.loads(arrays[0].tobytes()))
        self._policy = self._state = None
        self._policy = self._find_source().make(config, fields["seed"])
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
    """Describe an error, with its place in the policy's file."""
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
