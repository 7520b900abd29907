"""The playground: `surface-gym play`.

The command serves a page to the browser of this machine, and opens it. On the page, users throw
parcels, play tasks, and watch agents, also their own. Ctrl-C ends the command. The page runs the
package's physics as WebAssembly modules. A missing module is compiled at its first use, which takes
up to a minute.
"""

import argparse
import signal
import subprocess
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from surface_gym.cli import typed
from surface_gym.registration import SHIPPED, TASKS

PORT = 8642


def main(arguments: list[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog=typed("play"),
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    tasks = f"{', '.join(TASKS)}, or your own as path/to/file.py:Class"
    first = f"to begin with: {tasks}; by default an empty table"
    parser.add_argument("--task", help=first)
    watched = "folder of a training run, whose policy acts at first"
    parser.add_argument("--run", type=Path, help=watched)
    served = f"to serve pages at; 0: any that is free; by default {PORT}"
    parser.add_argument("--port", type=int, default=PORT, help=served)
    parser.add_argument(
        "--no-browser", action="store_true", help="only serve, and print the address"
    )
    options = parser.parse_args(arguments)
    try:
        if options.task not in (None, *TASKS) and ":" not in options.task:
            raise ValueError(f"task must be one of {tasks}, got {options.task!r}")
        serve(options.task, options.run, options.port, not options.no_browser)
    except (RuntimeError, ValueError) as error:
        sys.exit(f"error: {error}")


def serve(task: str | None, run: Path | None, port: int, opens: bool) -> None:
    """Serve the playground until Ctrl-C.

    Args:
        task: task that the page shows at first. Write a custom task as path/to/file.py:Class. If
            `task` is None, the page shows the task of `run`. If `run` is None, too, the page shows
            a surface without parcels.
        run: folder of a training run, whose policy acts at first.
        port: port of the server. 0 means any free port.
    """
    from surface_gym.web.build import AGENTS, PAGE, PackageModules
    from surface_gym.web.server import FIRST_PAGE, Server

    modules = PackageModules()
    folder = modules.folder
    with suppress(KeyboardInterrupt), ExitStack() as stack:
        # SIGTERM ends the server like Ctrl-C, so that no process goes on writing agents.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        stack.callback(signal.signal, signal.SIGTERM, before)
        server = stack.enter_context(Server((PAGE,), port, modules.prepare))
        page = FIRST_PAGE
        if task is not None or run is not None:
            from surface_gym.web.scene import TaskScene

            if run is not None:  # before anything is compiled
                from surface_gym.agents.export import web

                policy = web.read_run(run, task)
            beside = Path(stack.enter_context(TemporaryDirectory()))
            server.add(beside)
            name, agent = task, "you"
            if task is not None and task not in SHIPPED:
                from surface_gym.agents.library import find_task

                own = TASKS[task]() if task in TASKS else find_task(task)
                name = modules.add_own(own, beside)
                if find_spec("torch") is not None:
                    from surface_gym.agents.export import web

                    web.write_own_rules(own, name, beside, folder)
            if run is not None:
                name, agent = web.write_run(run, policy, name, task, beside, folder)
            assert name is not None  # there is a task or a run
            page = TaskScene(name, agent=agent, tasks=(name,)).url(FIRST_PAGE)
        server.add(folder)
        if not (folder / AGENTS[-1]).is_file():
            then = "reload the page" if run is None else "start again"
            stack.enter_context(writing_agents(folder, then))
        address = server.address + page
        print(f"the playground is at {address}\nCtrl-C ends it", flush=True)
        if opens:
            webbrowser.open(address)
        server.serve_forever()


@contextmanager
def writing_agents(folder: Path, then: str) -> Iterator[None]:
    """Write the agents into the folder of the WebAssembly modules, in a separate process.

    The first time, the process takes minutes. The text `then` tells the user how to see the
    agents, e.g. "reload the page".
    """
    if find_spec("torch") is None:
        print("no agents: torch is missing, pip install 'surface_gym[agents]'")
        yield
        return
    print(f"agents are made meanwhile: {then} in a few minutes to watch them")
    writing = subprocess.Popen(
        [sys.executable, "-m", "surface_gym.agents.export.web", str(folder)],
        start_new_session=True,  # only the server gets Ctrl-C, and then ends this process
    )
    try:
        yield
    finally:
        writing.terminate()
        writing.wait()


if __name__ == "__main__":
    main()
