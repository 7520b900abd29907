"""A video of one sort."""

from pathlib import Path
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
    video = gym.wrappers.RecordVideo(
        env,
        str(folder),
        episode_trigger=lambda episode: episode == 0,
        name_prefix=name,
        disable_logger=True,
    )
    observation, info = video.reset(seed=0, options=options)
    over = False
    while not over:
        action, _ = controller.predict(observation, deterministic=True)
        observation, _, terminated, truncated, info = video.step(action)
        over = terminated or truncated
    video.close()  # type: ignore[no-untyped-call]
    (folder / f"{name}-episode-0.mp4").replace(folder / f"{name}.mp4")
    return bool(info["is_success"])
