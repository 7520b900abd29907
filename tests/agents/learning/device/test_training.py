"""Runs on a device: they learn, are reproducible, and go on after a break as if there was none."""

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents.learning.checkpoint import FILE as CHECKPOINT
from agents.learning.config import PPOConfig
from agents.learning.curve import FILE as CURVE
from agents.learning.curve import read_curve
from agents.learning.device.lanes import Practice, make_lanes
from agents.learning.device.learner import Learner
from agents.learning.device.training import train_on_device
from agents.learning.legs import Learned, Progress
from agents.learning.start import start
from agents.policies.files import WEIGHTS, load_policy
from surface_gym import SmartSurfaceVectorEnv

from .lanes_on_cpu import LanesOnCpu, lanes_on_cpu

SMALL = PPOConfig(
    device="cuda", camera_share=0.0, seed=3, steps=2048, checkpoint_every=1024, lanes=16,
    n_steps=16, batch_size=64, n_epochs=2, hidden=(8, 8),
)  # fmt: skip


def train(config: PPOConfig, folder: Path, progress: Progress = lambda *_: None) -> Learned:
    folder.mkdir(exist_ok=True)
    return train_on_device(config, folder, progress, lanes_on_cpu)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    found: dict[str, torch.Tensor] = torch.load(folder / WEIGHTS, weights_only=True)
    return found


def same(one: Path, other: Path) -> bool:
    first, second = weights(one), weights(other)
    return all(torch.equal(value, second[name]) for name, value in first.items())


def test_it_learns_to_sort(tmp_path: Path) -> None:
    config = replace(
        SMALL, steps=65_536, checkpoint_every=10**6, lanes=128, n_steps=32, batch_size=1024,
        n_epochs=8, learning_rate=5e-3, hidden=(32, 32),
    )  # fmt: skip
    train(config, tmp_path)
    rows = read_curve(tmp_path)
    assert rows[-1]["success"] > 0.2
    assert rows[-1]["success"] > 5.0 * rows[3]["success"]
    assert rows[-1]["return"] > rows[3]["return"]


def test_a_seed_gives_its_weights_again_and_another_gives_others(tmp_path: Path) -> None:
    for name, seed in (("one", 3), ("again", 3), ("other", 4)):
        learned = train(replace(SMALL, seed=seed), tmp_path / name)
        assert (learned.steps, learned.interrupted) == (2048, False)
    assert same(tmp_path / "one", tmp_path / "again")
    assert not same(tmp_path / "one", tmp_path / "other")


@pytest.mark.parametrize("actions", ["halves", "quadrants"])
def test_a_run_broken_off_goes_on_to_the_same_weights_and_curve(
    actions: str, tmp_path: Path
) -> None:
    config = replace(SMALL, actions=actions)
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    train(config, whole)

    def stop(steps: int, success: float) -> None:
        del success
        if steps == 1536:
            raise KeyboardInterrupt

    learned = train(config, broken, stop)
    assert (learned.steps, learned.interrupted) == (1536, True)
    assert not same(broken, whole)
    reported: list[int] = []
    train(config, broken, lambda steps, _: reported.append(steps))
    assert reported == [1280, 1536, 1792, 2048]  # from the checkpoint at 1024
    assert same(broken, whole)
    assert (broken / CURVE).read_bytes() == (whole / CURVE).read_bytes()


def test_a_run_for_a_device_is_learned_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def make_vec(name: str, *, num_envs: int, device: str, **_: object) -> LanesOnCpu:
        assert (name, device) == ("SmartSurface/Sort-v0", "cuda")
        return lanes_on_cpu(SMALL, num_envs)

    monkeypatch.setattr(gym, "make_vec", make_vec)
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    start(SMALL, tmp_path / "one", lambda *_: None)
    train(SMALL, tmp_path / "other")
    assert same(tmp_path / "one", tmp_path / "other")


def test_its_policy_is_read_and_acts_as_any_of_ppo(tmp_path: Path) -> None:
    train(SMALL, tmp_path)
    policy = load_policy(tmp_path)
    assert (policy.card.algo, policy.card.hidden) == ("ppo", (8, 8))
    lanes = SmartSurfaceVectorEnv(5, **policy.env_kwargs)
    actions, _ = policy.predict(lanes.reset(seed=0)[0])
    lanes.step(actions)
    lanes.close()


def test_the_curve_tells_of_success_and_every_reward_term(tmp_path: Path) -> None:
    train(SMALL, tmp_path)
    rows = read_curve(tmp_path)
    assert [row["steps"] for row in rows] == list(range(256, 2049, 256))
    assert set(rows[0]) == {
        "steps", "success", "return", "length", "reward_reach", "reward_time", "reward_success",
        "reward_haste", "reward_failure",
    }  # fmt: skip
    last = rows[-1]
    terms = [value for name, value in last.items() if name.startswith("reward_")]
    assert last["return"] == pytest.approx(np.sum(terms), abs=1e-4)
    assert list((tmp_path / "tensorboard").glob("events*"))


def test_a_damaged_checkpoint_and_a_foreign_one_are_refused(tmp_path: Path) -> None:
    train(replace(SMALL, steps=256), tmp_path)
    with pytest.raises(ValueError, match="damaged or of another run"):
        train(replace(SMALL, hidden=(8, 9)), tmp_path)
    whole = (tmp_path / CHECKPOINT).read_bytes()
    (tmp_path / CHECKPOINT).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="damaged or of another run"):
        train(SMALL, tmp_path)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu_a_rollout_never_waits_and_a_seed_gives_its_weights_again(tmp_path: Path) -> None:
    learner = Learner(SMALL, Practice(make_lanes(SMALL, SMALL.lanes)))
    learner.begin(0)
    learner.roll_out()  # the first may compile
    torch.cuda.set_sync_debug_mode("error")
    try:
        learner.roll_out()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    for name in ("one", "again"):
        (tmp_path / name).mkdir()
        train_on_device(SMALL, tmp_path / name)
    assert same(tmp_path / "one", tmp_path / "again")
