"""`surface-gym compile`: compile the package's environments, rules and agents beforehand.

The machine code uses only instructions that most processors have (`compiler.jit.find_baseline`). It
is stored in the package, so wheels contain it, and `surface_gym.compiler.jit` loads it. Code that
is compiled on demand uses more instructions, but gives results that are equal to the bit.
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from surface_gym.cli import typed
from surface_gym.executors import Job, Report
from surface_gym.parallel import check_count, map_jobs, usable_cores
from surface_gym.registration import DEFAULT_TASK, SHIPPED

if TYPE_CHECKING:
    from surface_gym.env import SmartSurfaceEnv

PRESETS = ("exact", "lab")  # presets of environments of one parcel
TRAINED = (*PRESETS, "camera")  # presets in training and results of the default task
CACHE = "NUMBA_CACHE_DIR"  # Numba's variable with its cache folder
PROCESSOR, FEATURES = "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"  # Numba's target


def compile_task(task: str, report: Report) -> str:
    """Compile a task's default environment; return the environment's name for progress reports."""
    from surface_gym.env import SmartSurfaceEnv

    del report
    _run(SmartSurfaceEnv(task))
    return f"environment {task}"


def compile_method(task: str, index: int, preset: str, report: Report) -> str:
    """Compile a task's method `index` and the method's environment; return the method's name."""
    from surface_gym.env import SmartSurfaceEnv

    from ..evaluation.method import all_methods, find_benchmark

    del report
    method = all_methods(task)[index]
    shown: Any = find_benchmark(task).task
    if method.observed_task is not None:
        shown = method.observed_task(shown)
    env = SmartSurfaceEnv(shown, preset=preset, **method.arguments)
    _run(env, None if method.most else method.controller(env.config, method.seeds[0]))
    return f"{task}: {method.name}, {preset}"


def _run(env: "SmartSurfaceEnv", controller: Any = None) -> None:
    """Run one control period, so that environment and controller are compiled."""
    observation, _ = env.reset(seed=0)
    action = env.action_space.sample()
    if controller is not None:
        action, _ = controller.predict(observation)
    env.step(action)


def list_jobs() -> list[Job[str]]:
    """List jobs that compile all tasks' default environments, then all compared methods."""
    from ..evaluation.method import all_methods

    jobs: list[Job[str]] = [partial(compile_task, task) for task in SHIPPED]
    for task, shipped in SHIPPED.items():
        for index, method in enumerate(all_methods(task)):
            presets = TRAINED if task == DEFAULT_TASK else PRESETS
            for preset in presets if shipped.periods else PRESETS[:1]:
                if method.presets is None or preset in method.presets:
                    jobs.append(partial(compile_method, task, index, preset))
    return jobs


def compile_all(workers: int) -> None:
    """Compile everything in `workers` processes, and copy machine code to the package's folder."""
    from surface_gym.compiler.jit import LINKED, PRECOMPILED

    PRECOMPILED.mkdir(exist_ok=True)
    jobs, began = list_jobs(), time.perf_counter()
    for done, (_, what) in enumerate(map_jobs(jobs, workers), 1):
        for file in Path(os.environ[CACHE]).rglob("*.nb[ic]"):
            if not file.name.startswith(LINKED) and not (PRECOMPILED / file.name).exists():
                shutil.copy(file, PRECOMPILED)
        print(f"{done}/{len(jobs)}  {time.perf_counter() - began:4.0f} s  {what}", flush=True)
    files = list(PRECOMPILED.iterdir())
    size = sum(file.stat().st_size for file in files) / 1e6
    print(f"{len(files) // 2} kernels, {size:.1f} MB: {PRECOMPILED}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command in a new process, where Numba uses only common processor instructions."""
    parser = argparse.ArgumentParser(
        prog=typed("compile"),
        description="Compile environments, rules and agents beforehand. Run it again after an "
        "edit, or to go on after an interrupt.",
    )
    parser.add_argument("--workers", type=int, default=usable_cores(), help="number of processes")
    parser.add_argument("--resume", action="store_true", help="keep what is compiled")
    given = parser.parse_args(arguments)

    from surface_gym.compiler.jit import PRECOMPILED, find_baseline

    baseline = find_baseline()
    if baseline is None:
        sys.exit("error: this processor lacks instructions of the baseline of precompiled code")
    try:
        check_count("workers", given.workers)
    except ValueError as error:
        sys.exit(f"error: {error}")
    if os.environ.get(PROCESSOR) == baseline.name and CACHE in os.environ:
        compile_all(given.workers)
        return
    if not given.resume:
        shutil.rmtree(PRECOMPILED, ignore_errors=True)
    print(f"compiling for {baseline.name}; later commands take up to 2 s to begin", flush=True)
    with TemporaryDirectory() as cache:
        own = {CACHE: cache, PROCESSOR: baseline.name, FEATURES: ""}
        command = [sys.executable, "-m", __spec__.name, "--workers", str(given.workers)]
        sys.exit(subprocess.run(command, env={**os.environ, **own}, check=False).returncode)


if __name__ == "__main__":
    main()
