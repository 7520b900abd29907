"""One run of PPO on a device."""

from functools import partial
from pathlib import Path

from ...tasks import find_task
from ..config import PPOConfig
from ..legs import Learned, Progress
from ..run import run
from .lanes import MakeLanes, Practice, make_lanes
from .learner import Learner
from .totals import TotalsCurve


def train_on_device(
    config: PPOConfig,
    folder: Path,
    progress: Progress = lambda *_: None,
    make: MakeLanes = make_lanes,
) -> Learned:
    """Learn as the configuration says and leave a policy in `folder`.

    A checkpoint found there is gone on from. An interrupt keeps what was learned so far.

    Args:
        config: of the run.
        folder: of the run.
        progress: told after each rollout.
        make: makes the lanes.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration; or the device cannot be
            used.
    """

    def make_learner() -> Learner:
        return Learner(config, Practice(make(config, config.lanes)))

    def learn(learner: Learner, curve: TotalsCurve) -> None:
        curve.take_totals(learner.learn())

    make_curve = partial(TotalsCurve, folder, find_task(config.task).terms, config.lanes)
    return run(config, folder, progress, make_learner, make_curve, learn)


def check_device(config: PPOConfig) -> None:
    """Raise a ValueError where a run's lanes cannot be on its device: one is tried."""
    make_lanes(config, 1).close()
