"""Files for the Hugging Face Hub: an environment, a data set and a model's card."""

import importlib.util
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml

from surface_gym.agents import library
from surface_gym.agents.datasets import find_recipe, write_dataset

FOLDER = Path(__file__).parents[1] / "examples/hub"


def load(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(f"hub_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_environments_are_those_of_the_package() -> None:
    """With angles for actions, the last episode's info, and pictures."""
    ((env,),) = (each.values() for each in load("env").make_env(n_envs=2).values())
    alone = gym.make("SmartSurface/Sort-v0", actions="halves")
    observation, _ = env.reset(seed=4)
    expected, _ = alone.reset(seed=5)
    angles = np.array([[0.0, 0.0], [-0.25, -0.25]], dtype=np.float32) * math.pi
    over = False
    while not over:
        np.testing.assert_allclose(observation["agent_pos"][1], expected, atol=1e-5)
        observation, _, terminated, truncated, info = env.step(angles)
        expected, _, ended, cut, last = alone.step(10)  # both halves at -45 deg
        over = ended or cut
        assert over == (terminated[1] or truncated[1])
    assert info["final_info"]["is_success"][1] == last["is_success"]
    assert env.call("render")[0].shape[2] == 3
    assert list(load("env").make_env(cfg=SimpleNamespace(task="slow"))) == ["slow"]


def test_lerobot_takes_the_environments() -> None:
    pytest.importorskip("lerobot")
    from lerobot.envs.utils import _call_make_env, _normalize_hub_result, preprocess_observation

    made = _normalize_hub_result(_call_make_env(load("env"), 2, False, None))
    observation, _ = made["sort"][0].reset(seed=0)
    assert preprocess_observation(observation)["observation.state"].shape == (2, 15)


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("images", [False, True])
def test_lerobot_reads_the_data_set(images: bool, tmp_path: Path, monkeypatch: Any) -> None:
    pytest.importorskip("lerobot")
    import minari
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    write_dataset("own/sort-v0", find_recipe("sort", "rule"), 0, 3)
    load("lerobot_dataset").convert("own/sort-v0", tmp_path / "made", images)
    made, source = (
        LeRobotDataset("own/sort-v0", tmp_path / "made"),
        minari.load_dataset("own/sort-v0"),
    )
    assert (made.num_episodes, made.num_frames) == (3, source.total_steps)
    angles = np.array([0.0, 45.0, -45.0, 90.0])
    rows = [(each, k) for each in source for k in range(len(each))]
    for row, (episode, k) in zip(made, rows, strict=True):
        np.testing.assert_array_equal(row["observation.state"], episode.observations[k])
        halves = angles[list(divmod(int(episode.actions[k]), 4))]
        np.testing.assert_allclose(np.degrees(row["action"]), halves, atol=1e-4)
        assert bool(row["next.done"]) == (k == len(episode) - 1)
        assert ("observation.image" in row) == images


def test_a_models_card_has_the_results_of_its_run() -> None:
    folder = library.SHELF / "sort-ppo"
    text = load("model_card").make_card(folder)
    _, head, body = text.split("---\n", 2)
    shown = yaml.safe_load(head)["model-index"][0]["results"]
    run = yaml.safe_load((folder / "card.yaml").read_text())["results"]
    assert [each["metrics"][0]["value"] for each in shown] == [
        each["success"] for each in run.values()
    ]
    assert "| SmartSurface/Sort-v0, exact | 0.942 |" in body
