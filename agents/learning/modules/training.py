"""One run of modules that decide each for itself."""

from functools import partial
from pathlib import Path

from surface_gym.tasks.sort import TERMS

from ..config import ModulesConfig
from ..curve import Curve
from ..legs import Learned, Progress
from ..run import run
from .learner import Learner


def train_modules(
    config: ModulesConfig, folder: Path, progress: Progress = lambda *_: None
) -> Learned:
    """Learn as the configuration says and leave a policy in `folder`.

    A checkpoint found there is gone on from. An interrupt keeps what was learned so far.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration.
    """

    def learn(learner: Learner, curve: Curve) -> None:
        curve.take(learner.learn())

    return run(
        config, folder, progress, partial(Learner, config), partial(Curve, folder, TERMS), learn
    )
