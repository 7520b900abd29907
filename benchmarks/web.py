"""WebAssembly compared with the CPU: speed, and whether states are equal to the bit.

`python -m benchmarks.web` steps each task's environment by random actions, in turns on the CPU and
in node. Node uses JavaScript's sine and cosine. `--host` also compares states in wasmtime, which
calls the CPU's sine and cosine. These calls go through Python, so wasmtime's speed is not measured.
"""

import argparse
import gzip
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.compiler.wasm import compile_module
from surface_gym.compiler.wasm_image import MemoryImage, is_scratch, make_image, name_arguments
from surface_gym.compiler.wasm_machine import Machine
from surface_gym.config import EnvConfig
from surface_gym.core.batch import BaseBatch
from surface_gym.env import make_batch
from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.stream import Stream
from surface_gym.layouts import ROLLING
from surface_gym.registration import PERIODS
from surface_gym.state import RUNNING
from surface_gym.web.build import MODULES

# More parcels than can leave, so that the surface is full, as it is on slopes by default.
CROWDED = Stream(Poisson(5000.0, 0.15), parcels=("S", "B"), speeds=(1.0, 2.0))
ARGUMENTS: dict[str, dict[str, Any]] = {"flow": {"stream": CROWDED}}
TURNED = 0.1  # share of a command's parts that are random


class Twins:
    """The same environments twice: on the CPU and in a WebAssembly module.

    Args:
        file: file of the module, which is written if it is missing or outdated.
    """

    def __init__(self, config: EnvConfig, num_envs: int, file: Path | None = None) -> None:
        self.batch: BaseBatch = make_batch(config, num_envs)
        for i in range(num_envs):
            self.batch.seed(i, np.random.default_rng(i))
        self.kernel = self.batch.make_kernel()
        self.module = compile_module(self.kernel, self.batch.arguments, file)
        self.machine = Machine(self.module)
        self._generator = np.random.default_rng(0)
        self.all = np.arange(num_envs)

    @property
    def image(self) -> MemoryImage:
        """The batch's arrays as an image of the module's memory."""
        return make_image(self.kernel, self.batch.arguments)

    @property
    def are_over(self) -> bool:
        """Whether all episodes have ended."""
        return not (self.batch.outcome == RUNNING).any()

    def place(self) -> None:
        """Draw a start for each environment on the CPU, and copy the states to the module."""
        self.batch.place_drawn(self.all)
        self.machine.load(self.image)

    def begin(self) -> None:
        """Begin an episode of each environment, on the CPU and in the module."""
        self.place()
        self.batch.begin(self.all)
        self.machine.step()

    def sample(self) -> NDArray[Any]:
        """Draw commands (num_envs, size), in which most modules let parcels roll on."""
        command, config = self.batch.surfaces.command, self.batch.config
        sampled: NDArray[Any]
        rolling: float
        if config.action_kind.choices:
            sampled = self._generator.integers(config.action_kind.choices, size=command.shape)
            rolling = int(np.abs(np.array(config.chosen_orientations) - ROLLING).argmin())
        else:
            sampled, rolling = self._generator.uniform(0.0, np.pi, command.shape), ROLLING
        return np.where(self._generator.random(command.shape) < TURNED, sampled, rolling)

    def step(self, commands: NDArray[Any]) -> int:
        """Step the environments on the CPU and in the module; return the module's result."""
        self.batch.step(commands)
        self.machine.view("surfaces.command")[:] = commands
        drawn, held = self.batch.parcels.noise, self.machine.view("parcels.noise")
        anew = (drawn != held).any(axis=(1, 2))  # noise that was drawn ahead before the step
        held[anew] = drawn[anew]
        self.machine.view("parcels.noise_row")[anew] = 0
        return self.machine.step()

    def differences(self) -> list[str]:
        """List the names of arrays and numbers that are not equal to the bit."""
        named = name_arguments(self.kernel, self.batch.arguments)
        return [
            name
            for name, value in named.items()
            if not is_scratch(name)
            and np.asarray(value).tobytes() != self.machine.view(name).tobytes()
        ]


# Reads lines of JSON. "image" is a file with the memory at a start; "commands" is a file with the
# commands of "periods" steps. It writes its memory to the file "out", and prints the seconds.
NODE = """
const fs = require("fs"), [wasm, layoutFile] = process.argv.slice(1);
const module = new WebAssembly.Module(fs.readFileSync(wasm)), env = {};
for (const each of WebAssembly.Module.imports(module)) env[each.name] = Math[each.name];
const {memory, step} = new WebAssembly.Instance(module, {env}).exports;
let layout;
const bytes = () => new Uint8Array(memory.buffer);
require("readline").createInterface({input: process.stdin}).on("line", line => {
  const asked = JSON.parse(line);
  if (asked.image) {
    layout = JSON.parse(fs.readFileSync(layoutFile));
    const short = layout.end - memory.buffer.byteLength;
    if (short > 0) memory.grow(Math.ceil(short / 65536));
    bytes().set(fs.readFileSync(asked.image), layout.base);
  }
  const commands = asked.commands ? fs.readFileSync(asked.commands) : null;
  const size = commands ? commands.length / asked.periods : 0;
  const [, , at] = layout.fields["surfaces.command"], before = performance.now();
  let faults = 0;
  for (let k = 0; k < (asked.periods || 1); k++) {
    if (commands) bytes().set(commands.subarray(k * size, (k + 1) * size), at);
    faults |= step(layout.base);
  }
  const seconds = (performance.now() - before) / 1000;
  fs.writeFileSync(asked.out, bytes().subarray(layout.base, layout.base + layout.bytes));
  console.log(JSON.stringify({seconds, faults}));
});
"""


class Node:
    """A process of node that runs the module of `Twins`."""

    def __init__(self, twins: Twins, folder: Path) -> None:
        self._twins, self._folder = twins, folder
        (folder / "wasm").write_bytes(twins.module.code)
        (folder / "layout").write_text(twins.image.to_json())
        command = ["node", "-e", NODE, str(folder / "wasm"), str(folder / "layout")]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self, **files: bytes) -> float:
        """Begin from an `image`, or step by `commands` (periods, ...); return the time [s]."""
        asked: dict[str, Any] = {"out": str(self._folder / "out")}
        for name, content in files.items():
            (self._folder / name).write_bytes(content)
            asked[name] = str(self._folder / name)
        if "commands" in files:
            asked["periods"] = len(files["commands"]) // self._twins.batch.surfaces.command.nbytes
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        assert answer["faults"] == 0
        return float(answer["seconds"])

    def equals_the_batch(self) -> bool:
        """Return whether node's memory without scratch equals the batch to the bit."""
        return (self._folder / "out").read_bytes() == self._twins.image.block

    def close(self) -> None:
        """End node."""
        self._process.communicate()


class Result(NamedTuple):
    """Result of a comparison between the CPU and a module."""

    periods: int  # number of compared control periods
    equal: int  # number of periods before the first difference
    cpu: float  # [s] time on the CPU
    module: float  # [s] time in the module; 0: not measured


CHUNK = 20  # control periods between two comparisons
LONGEST = 200  # control periods of an episode


def run_in_node(twins: Twins, periods: int) -> Result:
    """Step environments on the CPU and in node, in turns."""
    with tempfile.TemporaryDirectory() as folder:
        node = Node(twins, Path(folder))
        done = equal = begun = 0
        cpu = module = 0.0
        same = True
        while done < periods:
            if done == 0 or begun >= LONGEST or twins.are_over:
                twins.place()
                # The layout may have changed: streams have more arrivals.
                (Path(folder) / "layout").write_text(twins.image.to_json())
                node.ask(image=twins.image.block)
                twins.batch.begin(twins.all)
                begun = 0
            commands = [twins.sample() for _ in range(CHUNK)]
            before = time.perf_counter()
            for each in commands:
                twins.batch.step(each)
            cpu += time.perf_counter() - before
            module += node.ask(commands=np.stack(commands).tobytes())
            done, begun = done + CHUNK, begun + CHUNK
            same = same and node.equals_the_batch()
            equal = done if same else equal
        node.close()
    return Result(done, equal, cpu, module)


def run_in_wasmtime(twins: Twins, periods: int) -> Result:
    """Step environments on the CPU and in wasmtime until states differ."""
    begun = 0
    for done in range(0, periods, CHUNK):
        if done == 0 or begun >= LONGEST or twins.are_over:
            twins.begin()
            begun = 0
        for _ in range(CHUNK):
            twins.step(twins.sample())
        begun += CHUNK
        if twins.differences():
            return Result(done + CHUNK, done, 0.0, 0.0)
    return Result(periods, periods, 0.0, 0.0)


# Columns of the table; times are for one control period of one environment.
COLUMNS = (
    "task     ",
    "   kB",
    "zipped",
    "wasmtime equal",
    "node equal",
    "CPU [us]",
    "node [us]",
    "speed",
)


def compare(task: str, seeds: int, periods: int, host: bool) -> list[str]:
    """Compare a task's environments; return a row of the table."""
    file = MODULES / f"{task}.wasm"
    twins = Twins(EnvConfig(task, **ARGUMENTS.get(task, {})), seeds, file=file)
    sizes = (len(twins.module.code), len(gzip.compress(twins.module.code, mtime=0)))
    row = [task, *(f"{size / 1000:.1f}" for size in sizes)]
    found = run_in_wasmtime(twins, periods) if host else None
    row.append(f"{found.equal} of {found.periods}" if found else "-")
    if shutil.which("node") is None:
        return [*row, "-", "-", "-", "-"]
    found = run_in_node(twins, periods)
    times = [1e6 * seconds / (found.periods * seeds) for seconds in (found.cpu, found.module)]
    row += [f"{found.equal} of {found.periods}", *(f"{time:.1f}" for time in times)]
    return [*row, f"{found.cpu / found.module:.2f}"]


def print_row(cells: Sequence[str]) -> None:
    """Print a row of the table, as Markdown."""
    first, *others = zip(cells, map(len, COLUMNS), strict=True)
    padded = [first[0].ljust(first[1]), *(cell.rjust(width) for cell, width in others)]
    print("|", " | ".join(padded), "|", flush=True)


def main() -> None:
    """Compare tasks, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.web", description=__doc__)
    parser.add_argument("--tasks", nargs="+", choices=list(PERIODS), default=list(PERIODS))
    parser.add_argument("--periods", type=int, default=1000, help="control periods of each seed")
    parser.add_argument("--seeds", type=int, default=20, help="environments, each of its own seed")
    parser.add_argument("--host", action="store_true", help="compare in wasmtime, too: slow")
    options = parser.parse_args()
    print_row(COLUMNS)
    print_row(["---", *("-" * (len(each.strip()) - 1) + ":" for each in COLUMNS[1:])])
    for task in options.tasks:
        print_row(compare(task, options.seeds, options.periods, options.host))


if __name__ == "__main__":
    main()
