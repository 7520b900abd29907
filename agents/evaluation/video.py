"""Videos of episodes, one or several side by side; `python -m surface_gym.agents.evaluation.video`
films a stream.
"""

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, repeat, zip_longest
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from gymnasium.utils.seeding import np_random
from moviepy.video.io.ffmpeg_writer import FFMPEG_VideoWriter
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.env import RENDER_FPS, SmartSurfaceEnv
from surface_gym.flow import arrivals, stream, task
from surface_gym.rendering import with_caption

from ..base import Controller
from ..rules.streams import SortEach, StreamEventRule

Picture = NDArray[np.uint8]

HOLD = 1.0  # [s] for which the last picture stays
BAR = 6  # [px] between pictures


@dataclass(frozen=True, eq=False)
class Player:
    """A controller in an environment, and the start of its episode."""

    name: str  # written over its pictures
    controller: Controller
    config: EnvConfig
    rng: np.random.Generator  # what the options leave open is drawn from
    options: dict[str, Any] | None = None


def write_comparison(
    players: Sequence[Player], file: Path, seconds: float = math.inf
) -> tuple[bool, ...]:
    """Write an mp4 of one episode of each controller, side by side, in real time.

    One that ends first waits for the others in its last picture.
    """
    period = min(player.config.control_period for player in players)
    episodes = [
        _repeated(play(player), round(player.config.control_period / period)) for player in players
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
    return tuple(bool(info.get("is_success", False)) for _, info in last)


def write_episode(
    player: Player, file: Path, seconds: float = math.inf, speed: float = 1.0
) -> None:
    """Write an mp4 of a stream's episode, or of its first part.

    Args:
        speed: [-] seconds of the episode in a second of the video. All control periods are shown,
            or as many as make 25 pictures a second.
    """
    if not file.parent.is_dir():
        raise ValueError(f"file must be in a folder that there is, got {str(file)!r}")
    duration = getattr(player.config.task, "duration", math.inf)
    checks.within("seconds", checks.positive("seconds", seconds), 0.0, duration)
    period = player.config.control_period
    every = math.ceil(checks.positive("speed", speed) / (period * RENDER_FPS) - 1e-9)
    last = math.ceil(seconds / period - 1e-9)
    write_video(
        (
            picture
            for number, (picture, info) in enumerate(play(player, last, every))
            if number % every == 0 or number == last or info["outcome"] != "running"
        ),
        speed / (period * every),
        file,
    )


def write_video(frames: Iterator[Picture], rate: float, file: Path) -> None:
    """Write an mp4 frame by frame, at `rate` [1/s]; the last one stays for a moment."""
    frame = next(frames)  # one by one: a minute of them would fill the memory
    height, width, _ = frame.shape
    with FFMPEG_VideoWriter(str(file), (width, height), rate, codec="libx264") as writer:
        writer.write_frame(frame)
        for frame in frames:
            writer.write_frame(frame)
        for _ in range(round(HOLD * rate)):
            writer.write_frame(frame)


def play(
    player: Player, periods: int | None = None, every: int = 1
) -> Iterator[tuple[Picture, dict[str, Any]]]:
    """Play an episode: the picture and `info` at the start and after each control period.

    Args:
        periods: control periods to play at most; None: until the episode ends.
        every: pictures of the control periods between are not drawn, and the latest is repeated.
    """
    env = _make_env(player.config)
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
        over = terminated or truncated or number == periods
        if over or number % every == 0:
            picture = env.render()
        yield picture, info
    env.close()


def _make_env(config: EnvConfig) -> gym.Env[Any, Any]:
    env = SmartSurfaceEnv(render_mode="rgb_array", **config.arguments())
    if isinstance(config.task, task.StreamTask):  # it ends by itself
        return env
    return gym.wrappers.TimeLimit(env, config.periods)


def _repeated(items: Iterator[Any], times: int) -> Iterator[Any]:
    return (item for each in items for item in repeat(each, times))


def _stacked(pictures: Sequence[Picture]) -> Picture:
    """Put pictures side by side, wide ones on top of each other, in even numbers of pixels."""
    height, width, _ = pictures[0].shape
    down = 2 * height < width
    bar = np.full((BAR, width, 3) if down else (height, BAR, 3), 255, dtype=np.uint8)
    row = [part for picture in pictures for part in (bar, picture)][1:]
    frame = np.concatenate(row, axis=0 if down else 1)
    return frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]


CONTROLLERS: dict[str, Callable[[EnvConfig], Controller]] = {
    "event": StreamEventRule,
    "sort": SortEach,
}


@dataclass(frozen=True)
class VideoConfig:
    """Film a controller and a stream whose parcels come at equal gaps."""

    file: tyro.conf.Positional[Path]
    """To write, an mp4."""
    controller: str = "event"
    """The controller: "event", the rule; or "sort", an agent that learned to sort one parcel."""
    rate: float = 5000.0
    """[parcels/h] that come."""
    parcels: tuple[str, ...] = ("S", "B")
    """Kinds of parcels, of equal odds."""
    entry_speed: float = 1.5
    """[m/s] of every parcel."""
    exits: str = "sides"
    """A preset: "sides" or "chutes"."""
    seconds: float = 60.0
    """[s] of the stream."""
    speed: float = 1.0
    """[-] of the video: seconds of the stream in a second."""
    seed: int = 0
    """Of the stream."""

    def __post_init__(self) -> None:
        checks.one_of("controller", self.controller, CONTROLLERS)
        _ = self.config

    @property
    def config(self) -> EnvConfig:
        return EnvConfig(
            "flow",
            stream=stream.Stream(arrivals.Steady(self.rate), self.parcels, speeds=self.entry_speed),
            exits=self.exits,
            actions="parcels",
            duration=self.seconds,
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Film a stream; an error ends it with one line."""
    try:
        command = tyro.cli(
            VideoConfig, prog="python -m surface_gym.agents.evaluation.video", args=arguments
        )
        config = command.config
        controller = CONTROLLERS[command.controller](config)
        player = Player(command.controller, controller, config, np_random(command.seed)[0])
        write_episode(player, command.file, command.seconds, command.speed)
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
