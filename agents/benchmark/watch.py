"""The watch of a policy's process: memory, other processes, output and files.

Linux lists a process's children in /proc. On other systems, only output and files are watched.
"""

import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PERIOD = 0.05  # [s] between looks at the processes
DISK_PERIODS = 10  # periods between looks at the files
MAX_OUTPUT = 2**24  # [bytes] printed
MAX_DISK = 2**28  # [bytes] of all files
BLOCK = 4096  # [bytes] least size of a file
TAIL = 4096  # [bytes] kept from the end of the output
END_TIME = 10.0  # [s] for processes to end
_SUBREAPER = 36  # option of prctl: orphans become children of this process


class ProcessWatch(threading.Thread):
    """A thread that ends a process, with all child processes, if the process exceeds a limit.

    Args:
        process: watched process, the leader of a session of its own.
        output: descriptor of the process's output; the thread closes it at the end.
        folder: folder of the process's files.
        memory: [bytes] limit for the process with its children.
        marker: text that only the environment variables of this process contain.
    """

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        output: int,
        folder: Path,
        memory: int,
        marker: bytes,
    ) -> None:
        super().__init__(daemon=True)
        self.reason: str | None = None  # the limit for which it ended the process
        self.allows_children = True  # whether other processes are allowed: until its code is loaded
        self._process, self._output, self._folder = process, output, folder
        self._memory, self._marker = memory, marker
        self._tail: deque[bytes] = deque()
        self._printed = 0
        self._has_output = True
        self._others: set[int] = set()  # IDs of all other processes found
        self._is_done = threading.Event()
        self._ending = threading.Lock()

    def run(self) -> None:
        """Watch the process until `finish` is called."""
        due, looks = 0.0, 0
        while not self._is_done.is_set():
            self._read(PERIOD)
            if time.monotonic() >= due and self.reason is None:
                reason = self._find_excess(looks % DISK_PERIODS == 0)
                if reason is not None:
                    self.reason = reason
                    self.end()
                due, looks = time.monotonic() + PERIOD, looks + 1

    def finish(self) -> None:
        """End the process with all its children, and the thread."""
        self.end()
        self._is_done.set()
        if self.is_alive():
            self.join()
        os.close(self._output)

    def last_line(self, timeout: float = 0.5) -> str:
        """Return the last line printed by an ended process. Wait up to `timeout` [s] for output."""
        deadline = time.monotonic() + timeout
        while self._has_output and time.monotonic() < deadline:
            time.sleep(0.01)
        lines = b"".join(self._tail)[-TAIL:].decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    def _read(self, timeout: float) -> None:
        """Read some output of the process, if there is any within `timeout` [s]."""
        if not self._has_output:
            self._is_done.wait(timeout)
            return
        if not select.select([self._output], [], [], timeout)[0]:
            return
        chunk = os.read(self._output, 2**16)
        self._has_output = bool(chunk)
        self._printed += len(chunk)
        self._tail.append(chunk)
        while len(self._tail) > 1 and sum(map(len, self._tail)) - len(self._tail[0]) >= TAIL:
            self._tail.popleft()

    def _find_excess(self, with_files: bool) -> str | None:
        """Describe the first exceeded limit; return None if no limit is exceeded.

        The size of files is measured only if `with_files` is true.
        """
        if self._printed > MAX_OUTPUT:
            return f"printed more than {MAX_OUTPUT >> 20} MiB"
        allowed = self.allows_children  # read first, since it may change during the search
        if self._find_others() and not allowed:
            return "started a process"
        if read_memory(self._process.pid) > self._memory:
            return f"used more than {self._memory / 2**30:g} GiB of memory"
        if with_files and measure_files(self._folder) > MAX_DISK:
            return f"wrote more than {MAX_DISK >> 20} MiB of files"
        return None

    def _find_others(self) -> set[int]:
        """Return the IDs of all descendants of the process, including orphans."""
        own = self._process.pid
        found = find_descendants(own) if self._process.returncode is None else set()
        for each in find_children(os.getpid()) - {own}:
            if (
                each in self._others
                or read_session(each) == own
                or self._marker in _read_status(each, "environ")
            ):
                found |= {each} | find_descendants(each)
        self._others |= found
        return found

    def end(self) -> None:
        """End the process and its children. Wait at most `END_TIME` [s] until all have ended."""
        deadline = time.monotonic() + END_TIME
        with self._ending:
            while time.monotonic() < deadline:
                others = self._find_others()
                for each in others:
                    with suppress(ProcessLookupError, PermissionError):
                        os.kill(each, signal.SIGKILL)
                    with suppress(ChildProcessError):  # it is not an orphan yet
                        os.waitpid(each, os.WNOHANG)
                if self._process.poll() is None:
                    with suppress(ProcessLookupError, PermissionError):
                        os.killpg(self._process.pid, signal.SIGKILL)
                elif not others:
                    return
                time.sleep(0.002)


def find_children(process: int) -> set[int]:
    """Return the IDs of a process's children, including zombies (ended, but not yet waited for)."""
    found: set[int] = set()
    with suppress(OSError):
        for task in os.listdir(f"/proc/{process}/task"):
            found.update(map(int, _read_status(process, f"task/{task}/children").split()))
    return found


def find_descendants(process: int) -> set[int]:
    """Return the IDs of a process's children, their children, and so on."""
    found: set[int] = set()
    waiting = [process]
    while waiting:
        new = find_children(waiting.pop()) - found
        found |= new
        waiting += new
    return found


def read_session(process: int) -> int:
    """Return the session ID of a process; 0 if there is no such process."""
    # The name before it may have spaces and brackets.
    fields = _read_status(process, "stat").rpartition(b")")[2].split()[3:4]
    return int(fields[0]) if fields else 0


def read_memory(process: int) -> int:
    """Return the resident memory [bytes] of a process, or 0 if the process does not exist."""
    pages = _read_status(process, "statm").split()[1:2]
    return int(pages[0]) * os.sysconf("SC_PAGE_SIZE") if pages else 0


def _read_status(process: int, name: str) -> bytes:
    """Read a file of a process in /proc; return no bytes if there is no such process."""
    with suppress(OSError):
        return Path(f"/proc/{process}/{name}").read_bytes()
    return b""


def measure_files(folder: Path) -> int:
    """Return the size [bytes] of all files and folders in a folder."""
    total = 0
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            with suppress(OSError):
                total += max(BLOCK, os.lstat(os.path.join(place, name)).st_size)
    return total


_adopting = threading.Lock()
_adoptions = 0


@contextmanager
def adopting_orphans() -> Iterator[None]:
    """On Linux, make this process the parent of its orphaned descendants."""
    _adopt(1)
    try:
        yield
    finally:
        _adopt(-1)


def _adopt(change: int) -> None:
    global _adoptions
    with _adopting:
        before, _adoptions = _adoptions, _adoptions + change
        if sys.platform == "linux" and (before == 0) != (_adoptions == 0):
            import ctypes

            ctypes.CDLL(None).prctl(_SUBREAPER, int(_adoptions > 0), 0, 0, 0)
