"""One run: learning in legs, each begun anew, so that a run broken off can go on unchanged."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError

import torch
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from agents.modules.config import ModulesConfig
from agents.modules.learner import Learner
from agents.modules.policy import ModulesCard, save_modules

CHECKPOINT = "checkpoint.pt"

Report = Callable[[int, float], None]  # control periods done, success of the latest episodes


@dataclass(frozen=True)
class ModulesLearned:
    """How a run ended."""

    steps: int  # control periods learned from
    seconds: float  # it took, this time
    interrupted: bool


def train_modules(
    config: ModulesConfig, folder: Path, console: Console, report: Report = lambda *_: None
) -> ModulesLearned:
    """Learn as the configuration says, under a progress bar, and leave a policy in `folder`.

    A checkpoint found there is gone on from, to the same weights as without the break. An
    interrupt keeps what was learned so far.

    Args:
        config: of the run.
        folder: that exists, for the policy and the checkpoint.
        console: to draw the bar on.
        report: called after every rollout.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration.
    """
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    started = time.perf_counter()
    learner = Learner(config)
    if (folder / CHECKPOINT).is_file():
        _load(learner, folder / CHECKPOINT)
    interrupted = False
    with _bar(console) as bar:
        row = bar.add_task(f"modules, seed {config.seed}", total=config.steps, success="-")

        def tell() -> None:
            bar.update(row, completed=learner.steps, success=f"{learner.success:.3f}")
            report(learner.steps, learner.success)

        try:
            _learn(config, learner, folder / CHECKPOINT, tell)
        except KeyboardInterrupt:
            interrupted = True
    save_modules(learner.network, ModulesCard(config.control_period, config.hidden), folder)
    return ModulesLearned(learner.steps, time.perf_counter() - started, interrupted)


def _learn(config: ModulesConfig, learner: Learner, file: Path, tell: Callable[[], None]) -> None:
    leg = -1
    while learner.steps < config.steps:
        if learner.steps // config.checkpoint_every > leg:
            leg = learner.steps // config.checkpoint_every
            _save(learner, file)
            learner.begin(leg)
        learner.learn()
        tell()
    _save(learner, file)


def _save(learner: Learner, file: Path) -> None:
    """Write the checkpoint whole or not at all."""
    waiting = file.with_suffix(".new")
    with waiting.open("wb") as whole:
        torch.save(learner.state(), whole)
        whole.flush()
        os.fsync(whole.fileno())
    waiting.replace(file)


def _load(learner: Learner, file: Path) -> None:
    try:
        learner.restore(torch.load(file, map_location="cpu", weights_only=True))
    except (
        UnpicklingError, EOFError, OSError, AttributeError, KeyError, RuntimeError, TypeError,
        ValueError,
    ) as error:  # fmt: skip
        raise ValueError(f"{file} is damaged or of another run: {error}") from error


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
        TextColumn("success {task.fields[success]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )
