"""The parts that the single and the vector environment share."""

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.core.batch import BaseBatch, Batch
from surface_gym.flow.task import StreamTask

RENDER_FPS = 25  # pictures a second at the default control period of 40 ms: real time

Picture = NDArray[Any]


def make_batch(
    config: EnvConfig, num_envs: int, threads: int = 1, max_episode_steps: int | None = None
) -> BaseBatch:
    """Make the batch of environments that a task needs: of one parcel each, or of a stream."""
    kind: Callable[..., BaseBatch] = Batch
    if isinstance(config.task, StreamTask):
        from surface_gym.flow.batch import StreamBatch as kind
    return kind(config, num_envs, threads, max_episode_steps)


def check_render_mode(render_mode: str | None, modes: list[str]) -> str | None:
    """A render mode, or an error that names those there are."""
    checks.one_of("render_mode", render_mode, (None, *modes))
    return render_mode
