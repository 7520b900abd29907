"""Runs: reproducible, gone on from after a break, and no other run's checkpoint taken."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from agents.learning.checkpoint import FILE as CHECKPOINT
from agents.learning.config import ModulesConfig
from agents.learning.curve import FILE as CURVE
from agents.learning.curve import read_curve
from agents.learning.hyperparams import defaults
from agents.learning.modules.practice import Practice
from agents.learning.modules.training import train_modules
from agents.policies.files import WEIGHTS, load_policy

SMALL = ModulesConfig(
    seed=3, steps=512, lanes=8, hidden=(8, 8), n_steps=16, batch_size=64, checkpoint_every=256
)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    found: dict[str, torch.Tensor] = torch.load(folder / WEIGHTS, weights_only=True)
    return found


def same(one: Path, other: Path) -> bool:
    first, second = weights(one), weights(other)
    return all(torch.equal(value, second[name]) for name, value in first.items())


def folder(tmp_path: Path, name: str) -> Path:
    made = tmp_path / name
    made.mkdir()
    return made


def test_a_seed_gives_its_weights_again_and_another_gives_others(tmp_path: Path) -> None:
    one, again, other = folders = [folder(tmp_path, name) for name in ("one", "again", "other")]
    for at, seed in zip(folders, (3, 3, 4), strict=True):
        learned = train_modules(replace(SMALL, seed=seed), at)
        assert (learned.steps, learned.interrupted) == (512, False)
    assert same(one, again)
    assert not same(one, other)
    assert load_policy(one).card.hidden == SMALL.hidden


def test_a_run_broken_off_goes_on_to_the_same_weights_and_curve(tmp_path: Path) -> None:
    whole, broken = folder(tmp_path, "whole"), folder(tmp_path, "broken")
    train_modules(SMALL, whole)

    def stop(steps: int, success: float) -> None:
        del success
        if steps == 384:
            raise KeyboardInterrupt

    learned = train_modules(SMALL, broken, stop)
    assert (learned.steps, learned.interrupted) == (384, True)
    assert not same(broken, whole)
    reported: list[int] = []
    train_modules(SMALL, broken, lambda steps, _: reported.append(steps))
    assert reported == [384, 512]  # from the checkpoint at 256
    assert same(broken, whole)
    assert (broken / CURVE).read_bytes() == (whole / CURVE).read_bytes()


def test_the_curve_tells_of_success_and_every_reward_term(tmp_path: Path) -> None:
    train_modules(SMALL, tmp_path)
    rows = read_curve(tmp_path)
    assert [row["steps"] for row in rows] == [128, 256, 384, 512]
    assert set(rows[0]) == {
        "steps", "success", "return", "length", "reward_reach", "reward_time", "reward_success",
        "reward_haste", "reward_failure",
    }  # fmt: skip
    assert list((tmp_path / "tensorboard").glob("events*"))


def test_a_damaged_checkpoint_and_a_foreign_one_are_refused(tmp_path: Path) -> None:
    train_modules(SMALL, tmp_path)
    with pytest.raises(ValueError, match="damaged or of another run"):
        train_modules(replace(SMALL, hidden=(8, 9)), tmp_path)
    whole = (tmp_path / CHECKPOINT).read_bytes()
    (tmp_path / CHECKPOINT).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="damaged or of another run"):
        train_modules(SMALL, tmp_path)


def test_it_learns_for_the_lab_from_what_is_shown_there(tmp_path: Path) -> None:
    lab = defaults("sort", "modules", condition="lab")
    assert isinstance(lab, ModulesConfig)
    small = replace(lab, steps=512, lanes=8, n_steps=16, batch_size=64, checkpoint_every=256)
    learned = train_modules(small, tmp_path)
    assert (learned.steps, learned.interrupted) == (512, False)
    policy = load_policy(tmp_path)
    assert policy.card.observe == lab.observe
    seen = Practice(small).reset(0)
    actions, _ = policy.predict(seen)
    assert actions.shape == (8, 64)
