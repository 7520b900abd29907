"""Films of a flow: `python -m agents.flow.film flow.mp4`, `--help` tells more."""

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from moviepy.video.io.ffmpeg_writer import FFMPEG_VideoWriter
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.faces.single import RENDER_FPS
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.env import FlowEnv
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.stream import Stream

from ..controller import Controller
from ..evaluation.films import LAST
from .event import EventRule
from .sorting import SortEach

Picture = NDArray[np.uint8]

CONTROLLERS: dict[str, Callable[[FlowSettings], Controller]] = {
    "event": EventRule,
    "sort": SortEach,
}


@dataclass(frozen=True)
class FlowFilmConfig:
    """Film a controller and a stream whose parcels come at equal gaps."""

    file: tyro.conf.Positional[Path]
    """To write, an mp4."""
    controller: str = "event"
    """Who decides: "event", the rule; or "sort", an agent that learned to sort one parcel."""
    rate: float = 5000.0
    """[parcels/h] that come."""
    parcels: tuple[str, ...] = ("S", "B")
    """Kinds of parcels, of equal odds."""
    entry_speed: float = 1.5
    """[m/s] of every parcel."""
    exits: str = "sides"
    """A preset: "sides" or "chutes"."""
    seconds: float = 60.0
    """[s] of the flow."""
    speed: float = 1.0
    """[-] of the film: seconds of the flow in a second."""
    seed: int = 0
    """Of the stream."""

    def __post_init__(self) -> None:
        checks.one_of("controller", self.controller, CONTROLLERS)
        _ = self.settings

    @property
    def settings(self) -> FlowSettings:
        """Of the environment."""
        return FlowSettings(
            Stream(Steady(self.rate), self.parcels, speeds=self.entry_speed),
            exits=self.exits,
            actions="parcels",
            duration=self.seconds,
        )


def write_flow_film(
    controller: Controller,
    settings: FlowSettings,
    seed: int,
    file: Path,
    seconds: float,
    speed: float = 1.0,
) -> None:
    """Write an mp4 of an episode, or of its first part.

    Args:
        controller: decides.
        settings: it acts under.
        seed: what the stream is drawn from.
        file: to write.
        seconds: [s] of the flow to show, at most the episode's.
        speed: [-] seconds of the flow in a second of the film. All control periods are shown, or as
            many as make 25 pictures a second.

    Raises:
        ValueError: no time to show or more than the episode lasts, a speed that is not positive, or
            a file in no folder.
        OSError: the file cannot be written.
    """
    if not file.parent.is_dir():
        raise ValueError(f"file must be in a folder that there is, got {str(file)!r}")
    checks.within("seconds", checks.positive("seconds", seconds), 0.0, settings.duration)
    period = settings.control_period
    every = math.ceil(checks.positive("speed", speed) / (period * RENDER_FPS) - 1e-9)
    rate = speed / (period * every)  # [1/s] pictures
    periods = math.ceil(seconds / period - 1e-9)
    film = _pictures(controller, settings, seed, periods, every)
    picture = next(film)
    height, width, _ = picture.shape
    with FFMPEG_VideoWriter(str(file), (width, height), rate, codec="libx264") as writer:
        writer.write_frame(picture)
        for picture in film:  # one by one: a minute of them would fill the memory
            writer.write_frame(picture)
        for _ in range(round(LAST * rate)):
            writer.write_frame(picture)


def _pictures(
    controller: Controller, settings: FlowSettings, seed: int, periods: int, every: int
) -> Iterator[Picture]:
    """The start, and what every so many control periods come to, the last of all in any case."""
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    env = FlowEnv(render_mode="rgb_array", **values)
    observation, _ = env.reset(seed=seed)
    yield _picture(env)
    state: Any = None
    begun = np.ones(1, dtype=np.bool_)
    for period in range(1, periods + 1):
        action, state = controller.predict(
            observation[np.newaxis], state, begun, deterministic=True
        )
        observation, _, terminated, truncated, _ = env.step(action[0])
        begun = np.zeros(1, dtype=np.bool_)
        over = terminated or truncated or period == periods
        if over or period % every == 0:
            yield _picture(env)
        if over:
            break
    env.close()


def _picture(env: FlowEnv) -> Picture:
    picture = env.render()
    assert picture is not None
    return picture


def main(arguments: list[str] | None = None) -> None:
    """Film what is asked for."""
    try:
        config = tyro.cli(FlowFilmConfig, prog="python -m agents.flow.film", args=arguments)
        controller = CONTROLLERS[config.controller](config.settings)
        write_flow_film(
            controller, config.settings, config.seed, config.file, config.seconds, config.speed
        )
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
