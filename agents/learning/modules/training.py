"""One run of modules that decide each for itself."""

import time
from pathlib import Path

import torch

from surface_gym.tasks.sort import TERMS

from ...policies.files import save_policy
from ..checkpoint import FILE, read_state, write_state
from ..config import ModulesConfig, card_of
from ..curve import Curve
from ..legs import Learned, Progress, leg_at, leg_seed
from .learner import Learner


def train_modules(
    config: ModulesConfig, folder: Path, progress: Progress = lambda *_: None
) -> Learned:
    """Learn as the configuration says and leave a policy in `folder`.

    A checkpoint found there is gone on from. An interrupt keeps what was learned so far.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration.
    """
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    started = time.perf_counter()
    learner = Learner(config)
    recent = read_state(folder, learner.restore) if (folder / FILE).is_file() else []
    curve = Curve(folder, TERMS, learner.steps, recent)
    interrupted = False
    try:
        _learn(config, learner, curve, folder, progress)
    except KeyboardInterrupt:
        interrupted = True
    curve.close()
    save_policy(learner.network, card_of(config), folder)
    return Learned(learner.steps, time.perf_counter() - started, interrupted)


def _learn(
    config: ModulesConfig, learner: Learner, curve: Curve, folder: Path, progress: Progress
) -> None:
    latest = -1
    while learner.steps < config.steps:
        leg = leg_at(config, learner.steps)
        if leg != latest:
            latest = leg
            write_state(learner.state(list(curve.recent)), folder)
            learner.begin(leg_seed(config, leg))
        curve.take(learner.learn())
        curve.write(learner.steps)
        progress(learner.steps, curve.success)
    write_state(learner.state(list(curve.recent)), folder)
