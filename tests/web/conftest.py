"""A browser, and the pages it opens, served as they are built."""

import contextlib
import io
import json
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from surface_gym.compiler.jit import locked
from surface_gym.web.server import Server

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WIDE, NARROW = (1400, 900), (400, 800)
PAGE = "playground.html"
STILL: dict[str, Any] = {"reduced_motion": "reduce"}  # so that the first scene waits


@pytest.fixture(scope="module")  # while Playwright is there, no other test can run a loop of events
def browser() -> Iterator[Any]:
    """Run the system's Chromium without a window."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine (apt install chromium)")
    with api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture(scope="session")
def modules(pytestconfig: pytest.Config) -> Path:
    """The folder in which modules stay from test to test, until their source is edited."""
    assert pytestconfig.cache is not None
    return pytestconfig.cache.mkdir("modules")


def copy_newer(folder: Path, into: Path) -> None:
    """Copy the modules of a folder that are missing or older in another."""
    for file in folder.glob("*.wasm"):
        there = into / file.name
        if not there.exists() or there.stat().st_mtime < file.stat().st_mtime:
            part = there.with_suffix(f".{os.getpid()}")  # other processes copy at the same time
            shutil.copy2(file, part)
            part.replace(there)


class Site:
    """Pages and modules in a folder, served on this machine.

    Args:
        folder: that nobody else writes into.
        kept: modules that all tests have compiled so far; None: none.
    """

    def __init__(self, folder: Path, kept: Path | None = None) -> None:
        self.folder, self._kept = folder, kept
        self._server = Server([folder])
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self._tasks: list[str] = []

    @property
    def address(self) -> str:
        return self._server.address

    def add(self, *tasks: str) -> "Site":
        from surface_gym.web.build import CAMERA, NOISE, SITE, TABLE, write_pages, write_task

        own = (TABLE, *([NOISE] if any(task.endswith(CAMERA) for task in tasks) else []), *tasks)
        new = [each for each in dict.fromkeys(own) if each not in self._tasks]
        # One process at a time compiles; those that wait find what it has compiled.
        with locked(self._kept / "lock") if new and self._kept is not None else nullcontext():
            if self._kept is not None:
                copy_newer(self._kept, self.folder)
            for task in new:
                write_task(task, self.folder)
                self._tasks.append(task)
            if self._kept is not None:
                copy_newer(self.folder, self._kept)
        listed = [task for task in self._tasks if task not in (TABLE, NOISE)]
        write_pages(self.folder, listed)
        assert json.loads((self.folder / SITE).read_text())["tasks"] == listed
        return self

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture(scope="session")
def site(modules: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """The site, of this process alone: others have other tasks and agents in theirs."""
    made = Site(tmp_path_factory.mktemp("site"), modules)
    yield made
    made.close()


@pytest.fixture
def tab(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open empty pages with settings of their own; in the end none may have had an error.

    What the console says, of `kinds`, is an error too, and so is a request to an address that does
    not begin as one of `own`.
    """
    contexts, wrong = [], []

    def opened(
        size: tuple[int, int] = WIDE, kinds: str = "", own: tuple[str, ...] = ("",), **options: Any
    ) -> Any:
        context = browser.new_context(viewport={"width": size[0], "height": size[1]}, **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(20_000)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda said: said.type in kinds and wrong.append(said.text))
        page.on("request", lambda asked: asked.url.startswith(own) or wrong.append(asked.url))
        return page

    yield opened
    for context in contexts:
        context.close()
    assert wrong == []


@pytest.fixture
def visit(site: Site, tab: Callable[..., Any]) -> Callable[..., Any]:
    """Open a page of the site, which asks for nothing from elsewhere."""

    def look(address: str, size: tuple[int, int] = WIDE, **options: Any) -> Any:
        page = tab(size, "error", (site.address, "data:", "blob:"), **options)
        page.goto(site.address + address)
        return page

    return look


@pytest.fixture
def play(site: Site, visit: Callable[..., Any]) -> Callable[..., Any]:
    """Open the playground, with the tasks named, when it is there."""

    def opened(*tasks: str, address: str = PAGE, **options: Any) -> Any:
        site.add("sort", *tasks)
        page = visit(address, **{**STILL, **options})
        page.wait_for_selector("canvas")
        return page

    return opened


def open_sort(play: Callable[..., Any], *tasks: str) -> Any:
    """Open the playground at Sort, with more tasks on offer."""
    page = play(*tasks)
    page.select_option("#task", "sort")
    wait_for(page, "playground.scene.task === 'sort'")
    return page


def wait_for(page: Any, what: str, most: float = 15.0) -> None:
    """Wait until an expression is true; the page's policy allows Playwright's own way not."""
    end = time.monotonic() + most
    while not page.evaluate(what):
        assert time.monotonic() < end, f"{what} has not come about: {page.inner_text('body')}"
        page.wait_for_timeout(30)


def end_in_python(env: Any, agent: Any, seed: int) -> tuple[list[float], str]:
    """Run an episode of one parcel; return its last time, pose and velocity, and its outcome."""
    observation, info = env.reset(seed=seed)
    state, over = None, False
    while not over:
        action, state = agent.predict(observation, state, deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    outcome = info["outcome"].name if terminated else "out of time"
    return [info["time"], *info["pose"], *info["velocity"]], outcome


def end_in_page(page: Any, agent: str, seed: int) -> tuple[list[float], str]:
    """Let an agent run an episode of one parcel in the page; return the same."""
    page.evaluate(f"playground.reopen({{ seed: {seed}, agent: '{agent}' }})")
    wait_for(page, f"playground.scene.seed === {seed} && playground.scene.agent === '{agent}'")
    (end,) = end_states(page)
    return end, page.evaluate("playground.shown[0].run.over")


def end_states(page: Any) -> list[list[float]]:
    """Run to the end; return the last time, pose and velocity of each parcel."""
    found: list[list[float]] = page.evaluate(
        """() => {
          const { run } = playground.shown[0];
          playground.pause();
          while (run.advance());
          return run.tracks.map(({ times, motion }) => [times.at(-1), ...motion.slice(-6)]);
        }"""
    )
    return found


def run_script(page: Any) -> list[list[str]]:
    """Run the page's Python script; return what it prints."""
    with page.expect_download() as saved:
        page.click("#python")
    script = saved.value.path().read_text()
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(script, "script", "exec"), {})
    return [line.split() for line in said.getvalue().splitlines()]


def check_script(page: Any) -> list[str]:
    """Assert that the script gives the reward and the time of the page's run; return the rest."""
    ((rewards, clock, *rest),) = run_script(page)
    run = page.evaluate("(({ run }) => [run.rewards, run.time])(playground.shown[0])")
    assert run == [float(rewards), float(clock)]
    return rest


def check_controls(page: Any) -> None:
    """Assert that controls have names and are reached by the keyboard; pictures have names."""
    wrong = page.evaluate(
        """() => [...document.querySelectorAll("button, select, input, canvas")]
          .filter((each) => !(each.innerText || each.labels?.[0]?.innerText || each.ariaLabel)
            || (each.tabIndex < 0 && each.role !== "img"))
          .map((each) => each.outerHTML)"""
    )
    assert wrong == []
