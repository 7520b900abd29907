"""Configuration of every test."""

import gc
import os
import signal
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import settings

from surface_gym.core.batch import BaseBatch
from surface_gym.state import RUNNING
from tests.order import COLLECTED, SMOKE, TOGETHER, is_nightly, place_of

# The same examples from run to run; the first one may wait for the compiler.
settings.register_profile("surface_gym", deadline=None, derandomize=True, max_examples=25)
# Others every night, and many: HYPOTHESIS_PROFILE=nightly.
settings.register_profile("nightly", deadline=None, max_examples=10_000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "surface_gym"))


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A screen that nobody sees."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    sys.modules["pygame"].display.quit()


def only_begin(*arguments: Any) -> int:
    """Begin an episode of every environment, as a kernel, but move and observe nothing."""
    for each in arguments:
        if hasattr(each, "outcome"):
            each.outcome[:] = RUNNING
    return 0


@pytest.fixture
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile no kernels: a test that only looks at spaces, starts and configurations is fast."""
    monkeypatch.setattr(BaseBatch, "_compile", lambda _: only_begin)


@pytest.fixture(scope="module", autouse=True)
def _frozen() -> None:
    """Let the garbage collector pass over what is there before a file's tests.

    Tests and libraries are millions of objects, which each collection would look at again.
    """
    gc.collect()
    gc.freeze()


def pytest_configure(config: pytest.Config) -> None:
    # A shell has what it runs in the background ignore Ctrl-C, and processes of tests with it,
    # which would wait for one for ever.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.addinivalue_line("markers", "smoke: enough for a first look, in a minute")
    config.addinivalue_line("markers", "nightly: long proofs, left out unless -m asks for them")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give the folders of TOGETHER to one process each, which makes their fixtures once."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            folder = next(filter(nodeid.startswith, TOGETHER), None)
            return folder or super()._split_scope(nodeid)

    return Scheduling(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect no garbage while libraries are imported, which stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if item.nodeid.startswith(SMOKE):
            item.add_marker("smoke")
        if is_nightly(item.nodeid):
            item.add_marker("nightly")
    config.stash[COLLECTED] = [item.nodeid for item in items]
    items.sort(key=lambda item: place_of(item.nodeid))
