"""The film and the picture of the comparison on flows."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from moviepy.video.io.ffmpeg_writer import FFMPEG_VideoWriter
from numpy.typing import NDArray

from surface_gym.flow.batch import FlowBatch
from surface_gym.rendering import with_caption
from surface_gym.scenes import Renderer
from surface_gym.state import RUNNING

from ..evaluation.films import BAR, LAST
from .capacity import SEED
from .cases import CURVE, Case
from .contenders import FlowContender

Picture = NDArray[np.uint8]

FILMED = 20.0  # [s]
SHOWN_AT = 12.0  # [s] since the start, of the picture


def write_flow_comparison(
    contenders: Sequence[FlowContender], case: Case, rate: float, file: Path
) -> None:
    """Write an mp4 of the same stream under several controllers, one above the other.

    Args:
        contenders: whose names are written over each; control periods are multiples of the least.
        case: which parcels, how fast.
        rate: [parcels/h] at which they come.
        file: to write.
    """
    period = min(contender.control_period for contender in contenders)
    names = [contender.name for contender in contenders]
    films = [
        _held(pictures_of(contender, case, rate), round(contender.control_period / period))
        for contender in contenders
    ]
    together = islice(zip(*films, strict=False), round(FILMED / period))
    frames = (_stacked(names, pictures) for pictures in together)
    frame = next(frames)
    height, width, _ = frame.shape
    with FFMPEG_VideoWriter(str(file), (width, height), 1.0 / period, codec="libx264") as writer:
        writer.write_frame(frame)
        for frame in frames:
            writer.write_frame(frame)
        for _ in range(round(LAST / period)):
            writer.write_frame(frame)


def write_flow_picture(contender: FlowContender, rate: float, file: Path) -> None:
    """Write a png of the stream that the film shows, in its midst.

    Args:
        contender: who decides.
        rate: [parcels/h] at which parcels come.
        file: to write.
    """
    at = round(SHOWN_AT / contender.control_period)
    imageio.imwrite(file, next(islice(pictures_of(contender, CURVE, rate), at, None)))


def pictures_of(contender: FlowContender, case: Case, rate: float) -> Iterator[Picture]:
    """One at the start and after each control period, drawn as they are asked for.

    Raises:
        ValueError: the contender cannot sort such parcels.
    """
    settings = contender.settings(case, rate)
    controller = contender.make(settings)
    if controller is None:
        raise ValueError(f"contender must be able to sort {case.label}, got {contender.name!r}")
    batch, actions = FlowBatch(settings, 1), settings.flow_actions
    batch.seed(0, np.random.default_rng((SEED, 0)))
    batch.start(np.zeros(1, dtype=np.int64))
    album = Renderer(batch, 0)
    album.record(begins=True)
    yield album.draw()
    state: Any = None
    while batch.outcome[0] == RUNNING:
        action, state = controller.predict(batch.observation, state)
        batch.advance(actions.commands(action, 1))
        album.record(begins=False)
        yield album.draw()


def _held(pictures: Iterator[Picture], times: int) -> Iterator[Picture]:
    """Each shown so many times."""
    for picture in pictures:
        for _ in range(times):
            yield picture


def _stacked(names: Sequence[str], pictures: Sequence[Picture]) -> Picture:
    """One above the other, each under its name; in even numbers of pixels for the codec."""
    bar = np.full((BAR, pictures[0].shape[1], 3), 255, dtype=np.uint8)
    parts = []
    for name, picture in zip(names, pictures, strict=True):
        parts += [with_caption(picture, name), bar]
    frame = np.concatenate(parts[:-1])
    return frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]
