"""The command that writes environments as WebAssembly: `surface-gym web FOLDER`.

Every task, with its default arguments and all groups of features, becomes four files: the module
`sort.wasm`; its memory `sort.bin`, with one environment at the start of seed 0; the memory's layout
`sort.json`; and the starts of more seeds, `sort.starts`. Variants of a task become files, too:
`sort-camera` has a camera, `sort-omni` has driven modules. The folder also gets the playground:
pages, scripts, and a table, which is a surface on which users throw parcels.
"""

import argparse
import gzip
import json
import os
import shutil
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surface_gym import __version__
from surface_gym.cli import IN_CHECKOUT, typed
from surface_gym.registration import DEFAULT_STREAM, DEFAULT_TASK, SHIPPED

if TYPE_CHECKING:
    from surface_gym.config import EnvConfig

PAGE = Path(__file__).parent / "page"
MODULES = Path(__file__).parent / "modules"  # the package's modules, part of a release
TABLE, NOISE = "table", "noise"
CAMERA = "-camera"  # suffix of a task's name with a camera
# Suffixes of a task's name with driven modules, written out since their registry needs Numba.
DRIVEN = ("-steered", "-omni", "-belt", "-popup")
DRIVEN_TASKS = (DEFAULT_TASK, DEFAULT_STREAM)  # tasks with driven modules on a page
TASKS = (
    *SHIPPED,
    *(task + CAMERA for task in SHIPPED),
    *(task + kind for task in DRIVEN_TASKS for kind in DRIVEN),
)
ALL = (TABLE, NOISE, *TASKS)
KINDS = ("wasm", "bin", "json", "starts")  # suffixes of a task's files
SITE = "site.json"  # description of the site, for pages
AGENTS = ("agents.bin", "agents.json")  # files of `surface_gym.agents.export.web`
EACH_AGENT = "agent-*.*"  # files of one agent, loaded when it is chosen


def make_config(task: Any, variant: str = "") -> "EnvConfig":
    """Return the configuration of a task's environment on a page.

    Args:
        task: a task's name, or a task with its own parameters.
        variant: "camera", a kind of driven modules, or "" for exact sensors and idle modules.
    """
    from surface_gym.config import EnvConfig
    from surface_gym.sensors import Camera, Exact

    sensors = Camera() if f"-{variant}" == CAMERA else Exact()
    modules = variant if f"-{variant}" in DRIVEN else "idle"
    config = EnvConfig(task, sensors=sensors, modules=modules)
    if config.task.is_stream:
        return config
    return config.replace(observe=tuple(config.groups))


def write_task(task: str, folder: Path, own: Any = None) -> str:
    """Write the files of a task into a folder; return a line that describes them.

    Args:
        task: base name of the files: `TABLE`, `NOISE`, or a task's name. The name may
            end in e.g. `-camera` or `-omni`.
        own: a custom task. If None, the package's task with the name in `task` is written.
    """
    from surface_gym.compiler.wasm import MATHEMATICS, compile_module
    from surface_gym.compiler.wasm_image import make_image
    from surface_gym.env import make_batch
    from surface_gym.web.starts import (
        CONTACTS,
        collect_starts,
        describe,
        draw_noise,
        noise_arguments,
    )
    from surface_gym.web.table import step_table, table_arguments

    more: dict[str, Any] = {"contacts": CONTACTS}
    if task == TABLE:
        kernel, arguments = step_table, table_arguments()
    elif task == NOISE:
        kernel, arguments = draw_noise, noise_arguments()
    else:
        name, _, variant = task.partition("-")
        config = make_config(own or name, variant)
        batch = make_batch(config, 1, compiles=False)
        starts = collect_starts(batch)
        kernel, arguments = batch.make_kernel(), batch.arguments
        (folder / f"{task}.starts").write_bytes(starts.block)
        more |= {
            "scene": describe(batch),
            "starts": {"fields": starts.fields, "marks": starts.marks, "noise": starts.noise},
        }
    code = compile_module(kernel, arguments, folder / f"{task}.wasm", tuple(MATHEMATICS)).code
    image = make_image(kernel, arguments)
    (folder / f"{task}.bin").write_bytes(image.block)
    layout = json.dumps({**image.layout(), **more}, separators=(",", ":"))
    (folder / f"{task}.json").write_text(layout + "\n")
    zipped = [len(gzip.compress(each, mtime=0)) / 1000 for each in (code, image.block)]
    return f"{task:16}  module {zipped[0]:5.1f} kB, memory {zipped[1]:5.1f} kB, both zipped"


def write_pages(folder: Path, tasks: Sequence[str]) -> None:
    """Write pages and scripts of the playground, and the list of its tasks (`site.json`).

    If `folder` is the package's folder `modules`, write only the list. The package has the pages
    and scripts in its folder `page`.
    """
    if folder != MODULES:
        shutil.copytree(PAGE, folder, dirs_exist_ok=True)
    has_agents = (folder / AGENTS[-1]).is_file()
    there = {"version": __version__, "tasks": list(tasks), "agents": has_agents}
    (folder / SITE).write_text(json.dumps(there) + "\n")


def write_site(folder: Path, tasks: Sequence[str]) -> None:
    """Write a site's pages and WebAssembly modules for `tasks` into a folder, and print progress.

    A module in the folder or the package is compiled again only if the module's source was edited.
    """
    folder.mkdir(parents=True, exist_ok=True)
    chosen = [TABLE, NOISE, *tasks]
    for number, task in enumerate(chosen, 1):
        print(f"{number}/{len(chosen)}  ", end="", flush=True)
        _copy(f"{task}.wasm", folder)
        print(write_task(task, folder), flush=True)
    _drop_old_agents(folder)
    for name in (*AGENTS, *sorted(file.name for file in MODULES.glob(EACH_AGENT))):
        _copy(name, folder)
    write_pages(folder, tasks)


def _drop_old_agents(folder: Path) -> None:
    """Remove the list of agents if a WebAssembly module is newer than the list.

    Older agents may not fit the newer module.
    """
    agents = folder / AGENTS[-1]
    compiled = max((each.stat().st_mtime for each in folder.glob("*.wasm")), default=0.0)
    if agents.is_file() and agents.stat().st_mtime < compiled:
        agents.unlink()


def _copy(name: str, folder: Path) -> None:
    """Copy the file `name` from the package's folder `modules`, unless `folder` has the file."""
    if (MODULES / name).is_file() and not (folder / name).exists():
        shutil.copyfile(MODULES / name, folder / name)


class PackageModules:
    """The package's WebAssembly modules, compiled when a page first requests their files.

    Existing files are reused. In a checkout, a module is compiled anew if its source was edited.
    """

    def __init__(self) -> None:
        self.folder = MODULES
        if not (MODULES / SITE).is_file() and not os.access(MODULES.parent, os.W_OK):
            self.folder = Path.home() / ".cache" / "surface_gym" / "modules"
        self._lock = threading.Lock()
        self._checked: set[str] = set()
        self._own: dict[str, tuple[Any, Path]] = {}  # custom task and its folder, by file name
        if not self._are_current():
            self.folder.mkdir(parents=True, exist_ok=True)
            for name in (AGENTS[-1], *(f"{task}.json" for task in ALL)):
                (self.folder / name).unlink(missing_ok=True)
            write_pages(self.folder, TASKS)

    def add_own(self, own: Any, folder: Path) -> str:
        """Write a custom task into a folder, and return the base name of the task's files.

        The task's version with a camera is compiled when a page first requests this version.
        """
        name = write_own(own, folder, self.folder)
        self._own[name + CAMERA] = own, folder
        return name

    def prepare(self, name: str) -> None:
        """Write all files of the task to which the file `name` belongs.

        Do nothing if `name` is not a file of a task, or if the task's files are up to date.
        """
        task, _, kind = name.partition(".")
        if task not in (*ALL, *self._own) or kind not in KINDS:  # e.g. table.js, a script
            return
        own, folder = self._own.get(task, (None, self.folder))
        with self._lock:
            if task in self._checked:
                return
            if IN_CHECKOUT or not (folder / f"{task}.json").is_file():
                print(f"{task}: compiling it takes up to a minute, if it is not there", flush=True)
                print(write_task(task, folder, own), flush=True)
            self._checked.add(task)

    def _are_current(self) -> bool:
        """Return whether the folder's file `SITE` is of this version and lists all tasks."""
        try:
            site = json.loads((self.folder / SITE).read_text())
            return bool(site["version"] == __version__ and site["tasks"] == list(TASKS))
        except (OSError, LookupError, TypeError, ValueError):
            return False


def write_own(own: Any, folder: Path, package: Path) -> str:
    """Write the files of a custom task into a folder; return their base name.

    Also copy the list of tasks from the folder `package`, and add the custom task to the copy.
    """
    name = type(own).__name__
    site = json.loads((package / SITE).read_text())
    print(f"{name}: compiling it takes up to a minute", flush=True)
    print(write_task(name, folder, own), flush=True)
    tasks = [*site["tasks"], name, name + CAMERA]
    (folder / SITE).write_text(json.dumps({**site, "tasks": tasks}) + "\n")
    return name


def main(arguments: Sequence[str]) -> None:
    """Write the pages and the modules of tasks. `arguments` may name the folder and the tasks."""
    parser = argparse.ArgumentParser(
        prog=typed("web"),
        description="Write environments as WebAssembly, and pages that run them in a browser.",
    )
    parser.add_argument("folder", type=Path, nargs="?", default=MODULES,
                        help="where to write; it is made if it is missing; by default into the "
                        "package, for `surface-gym play`")  # fmt: skip
    all_tasks = list(TASKS)
    listed = f"of {', '.join(all_tasks)}; by default all, which takes minutes"
    parser.add_argument("--tasks", nargs="+", choices=all_tasks, default=all_tasks, metavar="TASK",
                        help=listed)  # fmt: skip
    options = parser.parse_args(arguments)
    write_site(options.folder, options.tasks)
