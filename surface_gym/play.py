"""A surface to play with: `surface-gym play`.

It serves the playground to the browser on this machine and opens it: parcels to throw, tasks to
play, agents to watch, your own too, all by the package's own physics. Ctrl-C ends it. Where the
package came without the compiled modules that pages need, each is made when a page first asks for
it, which takes up to a minute, once.

With --window it opens a window instead, which needs a display. There the keys 1 2 3 4 stand for
axes at 0, 45, -45 and 90 deg. Space pauses, R starts again, Escape ends.

One parcel, with the goal of a task (--task sort, and others): press the mouse where the parcel is
to start and drag: it leaves with the speed drawn, 1 m/s for half a metre. 1 2 3 4 turn the axes of
the zone: all of them, with Shift those ahead of the parcel's centre, with Ctrl those behind it. Tab
turns the start by 15 deg, S and B choose the parcel.

A stream of parcels: with --task flow lead each to the exit of its colour; with singulate, merge and
sequence let them leave one by one. 1 2 3 4 choose an angle, and the modules that the mouse is drawn
over, pressed, turn to it; with Shift all do. + and - change how many parcels come.
"""

import argparse
import os
import subprocess
import sys
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock

from surface_gym.cli import typed
from surface_gym.registration import PERIODS

PORT = 8642
FRAME_RATE = 25.0  # [1/s] real time at the control period of 40 ms
ANSWER = 10.0  # [s] that a display is given to answer
PROBE = "import pygame; pygame.display.init(); print(pygame.display.get_driver())"


def check_display() -> None:
    """Raise a RuntimeError unless there is a display to open a window on.

    Without one SDL shows nothing to nobody, and one that does not answer holds it up for ever: it
    is tried in a process of its own.
    """
    names = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    given = ", ".join(f"{name}={os.environ[name]}" for name in names if os.environ.get(name))
    wanted = f"play --window needs a display to open its window on, got {given or 'no DISPLAY'}"
    try:
        probe = subprocess.run(
            [sys.executable, "-c", PROBE], capture_output=True, text=True, timeout=ANSWER
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"{wanted}, which does not answer within {ANSWER:g} s") from None
    from surface_gym.rendering.painter import UNSEEN

    if probe.returncode or probe.stdout.split()[-1:] in [[driver] for driver in UNSEEN]:
        raise RuntimeError(wanted)


def main(arguments: list[str] | None = None) -> None:
    """Play in a browser, or in a window."""
    parser = argparse.ArgumentParser(
        prog=typed("play"),
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    tasks = f"{', '.join(PERIODS)}, or in a browser your own as path/to/file.py:Class"
    first = f"to begin with: {tasks}; by default an empty table, in a window sort"
    parser.add_argument("--task", help=first)
    watched = "folder of a training run, whose policy acts at first"
    parser.add_argument("--run", type=Path, help=watched)
    served = f"to serve pages at; 0: any that is free; by default {PORT}"
    parser.add_argument("--port", type=int, default=PORT, help=served)
    parser.add_argument("--no-browser", action="store_true", help="only serve, and print where")
    parser.add_argument("--window", action="store_true", help="open a window, and no browser")
    options = parser.parse_args(arguments)
    try:
        is_own = options.task is not None and ":" in options.task and not options.window
        if not is_own and options.task not in (None, *PERIODS):
            raise ValueError(f"task must be one of {tasks}, got {options.task!r}")
        if options.window and options.run is not None:
            raise ValueError(f"run must be left out with --window, got {options.run}")
        if options.window:
            play_in_window(options.task or "sort")
        else:
            serve(options.task, options.run, options.port, not options.no_browser)
    except (RuntimeError, ValueError) as error:
        sys.exit(f"error: {error}")


def serve(task: str | None, run: Path | None, port: int, opens: bool) -> None:
    """Serve the playground until Ctrl-C.

    Args:
        task: shown at first, or an own one as path/to/file.py:Class; None: an empty table, or that
            of the run.
        run: folder of a training run, whose policy acts at first.
        port: to listen at; 0: any that is free.
        opens: whether a browser is opened.
    """
    from surface_gym.web.build import AGENTS, PAGE, SITE, PackageModules
    from surface_gym.web.server import FIRST_PAGE, Server

    modules, own_run = PackageModules(), OwnRun()
    folder = modules.folder

    def prepare(file: str) -> None:
        modules.prepare(file)
        if file == SITE:  # which a page reads before its agents
            own_run.join_once(folder / AGENTS[-1])

    pages = Server((PAGE,), port, prepare)
    with suppress(KeyboardInterrupt), ExitStack() as stack:
        server = stack.enter_context(pages)
        page = FIRST_PAGE
        if task is not None or run is not None:
            from surface_gym.web.scene import TaskScene

            beside = Path(stack.enter_context(TemporaryDirectory()))
            server.add(beside)
            name, agent = task, "you"
            if task is not None and ":" in task:
                from surface_gym.agents.library import find_task

                name = modules.add_own(find_task(task), beside)
            if run is not None:
                from surface_gym.agents.export import web

                own_run.write = partial(web.write_run, run, name, task, beside, folder)
                name, agent = own_run.write()
            assert name is not None  # there is a task or a run
            page = TaskScene(name, agent=agent, tasks=(name,)).url(FIRST_PAGE)
        server.add(folder)
        if (folder / AGENTS[-1]).is_file():
            own_run.write = None
        else:
            stack.enter_context(writing_agents(folder))
        address = server.address + page
        print(f"the playground is at {address}\nCtrl-C ends it", flush=True)
        if opens:
            webbrowser.open(address)
        server.serve_forever()


class OwnRun:
    """The policy of a run, which joins the package's agents when these are there."""

    def __init__(self) -> None:
        self.write: Callable[[], tuple[str, str]] | None = None  # None: there is none, or it has
        self._lock = Lock()

    def join_once(self, agents: Path) -> None:
        """Write it again, among those of a file, if that has come meanwhile."""
        with self._lock:
            if self.write is not None and agents.is_file():
                self.write()
                self.write = None


@contextmanager
def writing_agents(folder: Path) -> Iterator[None]:
    """Let a process of its own write the agents beside the modules, which takes minutes, once."""
    if find_spec("torch") is None:
        print("no agents: torch is missing, pip install 'surface_gym[agents]'")
        yield
        return
    print("agents are made meanwhile: reload the page in a few minutes to watch them")
    writing = subprocess.Popen(
        [sys.executable, "-m", "surface_gym.agents.export.web", str(folder)],
        start_new_session=True,  # Ctrl-C is for the server, which then ends it
    )
    try:
        yield
    finally:
        writing.terminate()
        writing.wait()


def play_in_window(task: str) -> None:
    """Play in a window until the player leaves."""
    check_display()
    print("opening a window; Escape ends")
    import pygame

    from surface_gym.game import Game, StreamGame, TaskGame
    from surface_gym.rendering import Window

    window = Window("Smart surface", FRAME_RATE)
    try:
        game: Game = StreamGame(task) if PERIODS[task] is None else TaskGame(task)
        window.show(game.draw())
        while not (game.over or window.closed):
            for event in pygame.event.get():
                game.take(event)
            game.advance()
            window.show(game.draw())
    finally:
        window.close()


if __name__ == "__main__":
    main()
