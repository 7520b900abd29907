"""Configuration of every test."""

import gc
import os
import signal
import sys
from collections.abc import Iterator

import pytest
from hypothesis import settings

from tests.order import NIGHTLY, SMOKE, place_of

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


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect no garbage while libraries are imported, which stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.nodeid.startswith(SMOKE):
            item.add_marker("smoke")
        if item.nodeid.startswith(NIGHTLY):
            item.add_marker("nightly")
    items.sort(key=lambda item: place_of(item.nodeid))
