"""Limits that a policy's process sets for itself before it loads the policy.

Resource limits bound memory, files and core dumps. An audit hook of Python refuses writing outside
a folder, processes and connections, and reports what it refused.

This bounds accidents and careless code. It is no security sandbox: code that calls the system
without Python, e.g. by ctypes, passes the hook. Run entries of strangers in a container.
"""

import errno
import os
import sys
from collections.abc import Callable
from typing import Any

FILE_SIZE = 2**26  # [bytes] of each file
OPEN_FILES = 256
PARENT_DEATH = 1  # option of prctl: a signal at the parent's end
KILL = 9

# Indices of paths, and of their folders' descriptors, in an event's arguments.
_LINKS = {
    "os.link": ((0, 2), (1, 3)),
    "os.mkdir": ((0, 2),),
    "os.remove": ((0, 1),),
    "os.rename": ((0, 2), (1, 3)),
    "os.rmdir": ((0, 1),),
    "os.symlink": ((1, 2),),
}
# The same for events that follow a link at the end of a path.
_FOLLOWED = {
    "os.chflags": ((0, None),),
    "os.chmod": ((0, 2),),
    "os.chown": ((0, 3),),
    "os.removexattr": ((0, None),),
    "os.setxattr": ((0, None),),
    "os.truncate": ((0, None),),
    "os.utime": ((0, 3),),
    "sqlite3.connect": ((0, None),),
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
_DEPTH = 20  # frames of the stack in which they are looked for


def set_limits(memory: int) -> None:
    """Set the resource limits of this process, and end it with its parent.

    Args:
        memory: [bytes] of private memory.
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
    """Refuse writing outside a folder, processes, connections and signals from now on.

    A refused call raises a PermissionError. Refused writing to a cache of compiled code is not
    reported, since libraries go on without.

    Args:
        folder: absolute path without links.
        caches: other folders of compiled code, likewise.
        report: called with what the policy did, e.g. "wrote to /home/x".
    """
    # Names of the module could be replaced by the policy by mistake.
    links, followed, refused, own = _LINKS, _FOLLOWED, _REFUSED, os.getpid()

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
                place = _find_place(path, -1, is_followed=True)
                # A folder itself cannot be written: Numba looks whether a file could be.
                is_unnamed = _UNNAMED != 0 and flags & _UNNAMED == _UNNAMED
                if not os.path.isdir(place) or (is_unnamed and not is_cache(place)):
                    check_place(event, place)
        elif event in refused:
            program = f": {arguments[0]}" if event in _PROGRAMS else ""
            refuse(refused[event] + program, not (event in _PROGRAMS and _is_curious()))
        elif event in links or event in followed:
            for path, descriptor in links.get(event) or followed[event]:
                inside = -1 if descriptor is None else arguments[descriptor]
                check_place(event, _find_place(arguments[path], inside, event in followed))
        elif event in _SIGNALS and arguments[0] not in (0, own):
            refuse("sent a signal to another process")

    sys.addaudithook(hook)


def _find_place(path: Any, descriptor: int, is_followed: bool) -> str:
    """Return the absolute path of a call's argument, without links."""
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
    """Return whether a module that only looks something up has made the call."""
    frame, depth = sys._getframe(), 0
    while frame.f_back is not None and depth < _DEPTH:
        frame, depth = frame.f_back, depth + 1
        if frame.f_globals.get("__name__") in _CURIOUS:
            return True
    return False
