"""A video of one sort."""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium as gym

from agents.controller import Controller
from surface_gym.settings import Settings


def record_sort(
    controller: Controller, settings: Settings, options: dict[str, Any], folder: Path, name: str
) -> bool:
    """Write NAME.mp4 of one episode from a fixed start into a folder; whether it was a sort."""
    env = gym.make(
        "SmartSurface/Sort-v0",
        actions=settings.actions,
        control_period=settings.control_period,
        zone=settings.zone,
        orientations=settings.orientations,
        render_mode="rgb_array",
    )
    with TemporaryDirectory() as films:
        success = _record(env, controller, options, films)
        (film,) = Path(films).glob("film/*.mp4")
        shutil.move(film, folder / f"{name}.mp4")
    return success


def _record(
    env: gym.Env[Any, Any], controller: Controller, options: dict[str, Any], films: str
) -> bool:
    """Film one episode into a folder of its own."""
    video = gym.wrappers.RecordVideo(
        env, str(Path(films) / "film"), episode_trigger=lambda _: True, disable_logger=True
    )
    observation, info = video.reset(seed=0, options=options)
    over = False
    while not over:
        action, _ = controller.predict(observation, deterministic=True)
        observation, _, terminated, truncated, info = video.step(action)
        over = terminated or truncated
    video.close()  # type: ignore[no-untyped-call]
    return bool(info["is_success"])
