"""Films of controllers at the same start, side by side."""

from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from moviepy import ImageSequenceClip
from numpy.typing import NDArray

from surface_gym.env import RENDER_FPS, SmartSurfaceEnv
from surface_gym.rendering import with_caption
from surface_gym.settings import Settings

from ..controller import Controller
from ..episodes import arguments

Picture = NDArray[np.uint8]
LAST = 1.0  # [s] for which the last picture stays
BAR = 6  # [px] between the two


def write_film(
    players: dict[str, tuple[Controller, Settings]], options: dict[str, Any], seed: int, file: Path
) -> list[bool]:
    """Write an mp4 of one episode of each controller from the same start; whether each succeeded.

    Args:
        players: by the name that is written over each, with the settings it acts under.
        options: of the start.
        seed: what the options leave open is drawn from.
        file: to write.

    The one that ends first waits for the others in its last picture.
    """
    pictures, successes = [], []
    for name, (controller, settings) in players.items():
        film, success = _play(controller, settings, options, seed)
        pictures.append([with_caption(picture, name) for picture in film])
        successes.append(success)
    frames = [_stacked(row) for row in _together(pictures)]
    frames += [frames[-1]] * round(LAST * RENDER_FPS)
    clip = ImageSequenceClip(frames, fps=RENDER_FPS)
    clip.write_videofile(str(file), codec="libx264", audio=False, logger=None)
    return successes


def _play(
    controller: Controller, settings: Settings, options: dict[str, Any], seed: int
) -> tuple[list[Picture], bool]:
    bare = SmartSurfaceEnv(render_mode="rgb_array", **arguments(settings))
    env = gym.wrappers.TimeLimit(bare, settings.chosen_task.periods)
    observation, info = env.reset(seed=seed, options=options)
    film = [_picture(env)]
    state: Any = None
    over, begun = False, np.ones(1, dtype=np.bool_)
    while not over:
        action, state = controller.predict(
            observation[np.newaxis], state, begun, deterministic=True
        )
        observation, _, terminated, truncated, info = env.step(action[0])
        film.append(_picture(env))
        over, begun = terminated or truncated, np.zeros(1, dtype=np.bool_)
    env.close()
    return film, bool(info["is_success"])


def _picture(env: gym.Env[Any, Any]) -> Picture:
    picture: Any = env.render()
    return np.asarray(picture, dtype=np.uint8)


def _together(films: list[list[Picture]]) -> Iterator[list[Picture]]:
    last = [film[-1] for film in films]
    for row in zip_longest(*films):
        yield [end if shown is None else shown for shown, end in zip(row, last, strict=True)]


def _stacked(pictures: list[Picture]) -> Picture:
    """Beside each other, wide ones one above the other; in even numbers of pixels for the codec."""
    height, width, _ = pictures[0].shape
    down = 2 * height < width
    bar = np.full((BAR, width, 3) if down else (height, BAR, 3), 255, dtype=np.uint8)
    row = [pictures[0]]
    for picture in pictures[1:]:
        row += [bar, picture]
    frame = np.concatenate(row, axis=0 if down else 1)
    return frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]
