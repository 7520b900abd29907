"""Videos of episodes, one or several side by side."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, repeat, zip_longest
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from moviepy.video.io.ffmpeg_writer import FFMPEG_VideoWriter
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.player import replay
from surface_gym.recorder import RecordReplay
from surface_gym.rendering import with_caption

from ..base import Controller

Picture = NDArray[np.uint8]

HOLD = 1.0  # [s] duration of the last picture
BAR = 6  # [px] between pictures


@dataclass(frozen=True, eq=False)
class Player:
    """A controller in an environment, and the start of its episode."""

    name: str  # title of its pictures
    controller: Controller
    config: EnvConfig
    rng: np.random.Generator  # source of random values that the options leave open
    options: dict[str, Any] | None = None


def write_comparison(
    players: Sequence[Player], file: Path, seconds: float = math.inf
) -> tuple[bool, ...]:
    """Write an mp4 of one episode per controller side by side, and the same replay as .html.

    The video runs in real time. A finished episode shows its last picture until the others end.
    """
    period = min(player.config.control_period for player in players)
    envs = [RecordReplay(make_env(player.config)) for player in players]
    episodes = [
        _repeated(play(player, env=env), round(player.config.control_period / period))
        for player, env in zip(players, envs, strict=True)
    ]
    last: list[Any] = [None] * len(players)

    def frames() -> Iterator[Picture]:
        for row in zip_longest(*episodes):
            last[:] = [old if new is None else new for old, new in zip(last, row, strict=True)]
            yield _stacked(
                [with_caption(p, each.name) for (p, _), each in zip(last, players, strict=True)]
            )

    shown = islice(frames(), None if math.isinf(seconds) else round(seconds / period))
    write_video(shown, 1.0 / period, file)
    runs = [replace(env.recording, title=p.name) for p, env in zip(players, envs, strict=True)]
    replay(*runs).save(file.with_suffix(".html"))
    return tuple(bool(info.get("is_success", False)) for _, info in last)


def write_video(frames: Iterator[Picture], rate: float, file: Path) -> None:
    """Write an mp4 frame by frame at `rate` [1/s]; the last frame is held."""
    frame = next(frames)  # one by one, since a minute of frames would fill the memory
    height, width, _ = frame.shape
    with FFMPEG_VideoWriter(str(file), (width, height), rate, codec="libx264") as writer:
        writer.write_frame(frame)
        for frame in frames:
            writer.write_frame(frame)
        for _ in range(round(HOLD * rate)):
            writer.write_frame(frame)


def make_env(config: EnvConfig) -> gym.Env[Any, Any]:
    """Make the environment of a video."""
    env: gym.Env[Any, Any] = SmartSurfaceEnv(render_mode="rgb_array", **config.arguments())
    if config.task.is_stream:  # streams end by themselves
        return env
    return gym.wrappers.TimeLimit(env, config.periods)


def play(
    player: Player, every: int = 1, env: gym.Env[Any, Any] | None = None
) -> Iterator[tuple[Picture, dict[str, Any]]]:
    """Play an episode; yield picture and `info` at the start and after each control period.

    Args:
        every: draw only every n-th picture, and repeat it in between.
        env: environment to use; None: make one.
    """
    if env is None:
        env = make_env(player.config)
    env.unwrapped.np_random = player.rng
    observation, info = env.reset(options=player.options)
    picture: Any = env.render()
    yield picture, info
    state: Any = None
    begun, number, over = np.ones(1, dtype=np.bool_), 0, False
    while not over:
        action, state = player.controller.predict(
            observation[np.newaxis], state, begun, deterministic=True
        )
        observation, _, terminated, truncated, info = env.step(action[0])
        begun, number = np.zeros(1, dtype=np.bool_), number + 1
        over = terminated or truncated
        if over or number % every == 0:
            picture = env.render()
        yield picture, info
    env.close()


def _repeated(items: Iterator[Any], times: int) -> Iterator[Any]:
    return (item for each in items for item in repeat(each, times))


def _stacked(pictures: Sequence[Picture]) -> Picture:
    """Place pictures side by side, or one below the other if they are wide.

    Width and height of the result are even numbers of pixels.
    """
    height, width, _ = pictures[0].shape
    down = 2 * height < width
    bar = np.full((BAR, width, 3) if down else (height, BAR, 3), 255, dtype=np.uint8)
    row = [part for picture in pictures for part in (bar, picture)][1:]
    frame = np.concatenate(row, axis=0 if down else 1)
    return frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]
