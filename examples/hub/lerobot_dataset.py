"""Convert a data set of Minari to LeRobot's format, with the states and actions of env.py.

surface-gym dataset sort --policy rule --episodes 100
python examples/hub/lerobot_dataset.py smart-surface/sort/rule-v0 lerobot-sort --images
"""

import argparse
from pathlib import Path
from typing import Any

import gymnasium as gym
import minari
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from numpy.typing import NDArray

STATE, ACTION, IMAGE = "observation.state", "action", "observation.image"


def find_angles(env: gym.Env[Any, Any], actions: NDArray[Any]) -> NDArray[np.float32]:
    """Return the angles [rad] (periods, 2) of axes ahead of the parcel and behind, of "halves"."""
    config: Any = env.unwrapped.config  # type: ignore[attr-defined]
    if config.actions != "halves":
        raise ValueError(f"actions of the data set must be 'halves', got {config.actions!r}")
    angles = np.array(config.chosen_orientations, dtype=np.float32)
    return angles[np.stack(np.divmod(actions, len(angles)), axis=-1)]


def draw(env: gym.Env[Any, Any], seed: int, actions: NDArray[Any]) -> list[NDArray[np.uint8]]:
    """Return a picture before each action; the episode with the seed is played again."""
    env.reset(seed=seed)
    pictures = []
    for action in actions:
        picture: Any = env.render()
        pictures.append(picture)
        env.step(action)
    return pictures


def convert(name: str, folder: Path, images: bool) -> None:
    """Write all episodes of a data set to a folder."""
    source = minari.load_dataset(name)
    env = source.recover_environment(render_mode="rgb_array")
    task = str(source.storage.metadata["description"])
    size = source.observation_space.shape
    features: dict[str, Any] = {
        STATE: {"dtype": "float32", "shape": size, "names": None},
        ACTION: {"dtype": "float32", "shape": (2,), "names": ["ahead", "behind"]},
        "next.reward": {"dtype": "float32", "shape": (1,), "names": None},
        "next.done": {"dtype": "bool", "shape": (1,), "names": None},
    }
    if images:
        env.reset(seed=0)
        picture: Any = env.render()
        names = ["height", "width", "channel"]
        features[IMAGE] = {"dtype": "image", "shape": picture.shape, "names": names}
    fps = round(1.0 / env.unwrapped.config.control_period)
    made = LeRobotDataset.create(name, fps, features, root=folder, use_videos=False)
    marks = source.storage.get_episode_metadata(range(len(source)))
    for episode, mark in zip(source, marks, strict=True):
        pictures = draw(env, mark["seed"], episode.actions) if images else []
        for k, angles in enumerate(find_angles(env, episode.actions)):
            made.add_frame(
                {
                    STATE: episode.observations[k],
                    ACTION: angles,
                    "next.reward": np.array([episode.rewards[k]], dtype=np.float32),
                    "next.done": np.array([k == len(episode) - 1]),
                    "task": task,
                    **({IMAGE: pictures[k]} if images else {}),
                }
            )
        made.save_episode()
    made.finalize()


def main() -> None:
    """Run the command above."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name", help="of the data set in Minari")
    parser.add_argument("folder", type=Path, help="of the new data set")
    parser.add_argument("--images", action="store_true", help="draw a picture for every state")
    given = parser.parse_args()
    convert(given.name, given.folder, given.images)


if __name__ == "__main__":
    main()
