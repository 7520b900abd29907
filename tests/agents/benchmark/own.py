"""Policies of the tests, good and bad; each runs in a process of its own."""

import ctypes
import mmap
import os
import pathlib
import signal
import socket
import stat
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress

import numpy as np

USED = (subprocess, urllib.request)  # by policies that are written out in tests

OUTSIDE = "/var/tmp/surface-gym-outside"
LIBC = None if sys.platform == "win32" else ctypes.CDLL(None)


class Draws:
    """Draws actions at random, and remembers how many."""

    env_kwargs = {"actions": "halves", "control_period": 0.08}

    def __init__(self, config, seed):
        self.choices, self.rng = config.action_space().n, np.random.default_rng(seed)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        assert episode_start is not None
        count = 0 if state is None else state[0]
        drawn = self.rng.integers(self.choices, size=len(observation))
        return (drawn + count) % self.choices, [count + 1]


class Zeros(Draws):
    """Chooses 0, and uses what a policy may use."""

    @classmethod
    def env_kwargs(cls, task, preset):
        assert (task, preset) == ("sort", "lab")
        return {"actions": "halves"}

    def __init__(self, config, seed):
        super().__init__(config, seed)
        home = pathlib.Path.home()
        assert home == pathlib.Path.cwd()
        (home / "folder").mkdir()
        (home / "folder" / "file").write_text("text")
        (home / "folder" / "file").rename(home / "other")
        (home / "link").symlink_to(OUTSIDE)
        (home / "link").unlink()
        home.joinpath("folder").chmod(0)
        pathlib.Path(os.devnull).write_text("text")
        assert sys.stdin.read() == ""
        assert os.environ["OMP_NUM_THREADS"] == "1"
        print("printed")

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros(len(observation), dtype=np.int64), None


class Bad(Zeros):
    """Does in `predict` what its method `act` does."""

    env_kwargs = {"actions": "halves"}

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        given = self.act()
        actions = super().predict(observation)[0] if given is None else given
        return actions, None

    def act(self):
        """Return actions; None: good ones."""


class Loops(Bad):
    def act(self):
        with suppress(BaseException):
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            time.sleep(0.001)


class Raises(Bad):
    def act(self):
        raise ValueError("two\nlines \x1b[31m")


class ForksTwiceNatively(Bad):
    """Leaves an orphan in another session."""

    def act(self):
        if LIBC.fork() == 0:
            if LIBC.fork() == 0:
                LIBC.setsid()
                time.sleep(100.0)
            os._exit(0)
        time.sleep(10.0)


class FillsDisk(Bad):
    def act(self):
        for k in range(20):
            with open(f"file {k}", "wb") as file:
                file.write(bytes(2**25))
        time.sleep(10.0)


class WritesLongFile(Bad):
    def act(self):
        with open("file", "wb") as file:
            for _ in range(100):
                file.write(bytes(2**20))


class EatsMemory(Bad):
    def act(self):
        kept = []
        while True:
            kept.append(np.ones(2**22))


class EatsSharedMemory(Bad):
    """Memory that is not private passes the resource limit."""

    def act(self):
        memory = mmap.mmap(-1, 2**32)
        for k in range(2**8):
            memory[k * 2**24 : (k + 1) * 2**24] = bytes(2**24)
            time.sleep(0.005)


class PrintsMuch(Bad):
    def act(self):
        for _ in range(100):
            print("x" * 2**20)


def connection():
    """Find the socket to the parent."""
    for each in range(3, 256):
        with suppress(OSError):
            if stat.S_ISSOCK(os.fstat(each).st_mode):
                return socket.socket(fileno=os.dup(each))
    raise AssertionError("no socket")


def send_message(header):
    """Send a header with eight bytes of arrays."""
    prefix = len(header).to_bytes(4, "little") + (8).to_bytes(4, "little")
    connection().sendall(prefix + header + bytes(8))


class StrangeError(Exception):
    def __str__(self):
        raise RuntimeError
