"""Runs: reproducible, gone on from after a break, and no other run's checkpoint taken."""

import io
from pathlib import Path

import pytest
import torch
from rich.console import Console

from agents.modules import ModulesConfig, load_modules, train_modules
from agents.modules.policy import WEIGHTS
from agents.modules.training import CHECKPOINT

SMALL = ModulesConfig(
    seed=3, steps=512, lanes=8, hidden=8, n_steps=16, batch_size=64, checkpoint_every=256
)


def silent() -> Console:
    return Console(file=io.StringIO())


def weights(folder: Path) -> dict[str, torch.Tensor]:
    found: dict[str, torch.Tensor] = torch.load(folder / WEIGHTS, weights_only=True)
    return found


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return all(torch.equal(value, other[name]) for name, value in one.items())


def folder(tmp_path: Path, name: str) -> Path:
    made = tmp_path / name
    made.mkdir()
    return made


def test_a_seed_gives_its_weights_again_and_another_gives_others(tmp_path: Path) -> None:
    folders = [folder(tmp_path, name) for name in ("one", "again", "other")]
    for at, seed in zip(folders, (3, 3, 4), strict=True):
        learned = train_modules(ModulesConfig(**{**vars(SMALL), "seed": seed}), at, silent())
        assert (learned.steps, learned.interrupted) == (512, False)
    one, again, other = map(weights, folders)
    assert same(one, again)
    assert not same(one, other)
    assert load_modules(folders[0]).card.hidden == SMALL.hidden


def test_a_run_broken_off_goes_on_to_the_same_weights(tmp_path: Path) -> None:
    whole, broken = folder(tmp_path, "whole"), folder(tmp_path, "broken")
    train_modules(SMALL, whole, silent())

    def stop(steps: int, success: float) -> None:
        del success
        if steps == 384:
            raise KeyboardInterrupt

    learned = train_modules(SMALL, broken, silent(), stop)
    assert (learned.steps, learned.interrupted) == (384, True)
    assert not same(weights(broken), weights(whole))
    reported: list[int] = []
    train_modules(SMALL, broken, silent(), lambda steps, _: reported.append(steps))
    assert reported == [384, 512]  # from the checkpoint at 256
    assert same(weights(broken), weights(whole))


def test_a_damaged_checkpoint_and_a_foreign_one_are_refused(tmp_path: Path) -> None:
    train_modules(SMALL, tmp_path, silent())
    wider = ModulesConfig(**{**vars(SMALL), "hidden": 9})
    with pytest.raises(ValueError, match="damaged or of another run"):
        train_modules(wider, tmp_path, silent())
    whole = (tmp_path / CHECKPOINT).read_bytes()
    (tmp_path / CHECKPOINT).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="damaged or of another run"):
        train_modules(SMALL, tmp_path, silent())


@pytest.mark.parametrize(
    ("field", "value"),
    [("seed", -1), ("steps", 0), ("haste", -1.0), ("parted", 1.5), ("friction", 1.0), ("gamma", 2)],
)
def test_a_field_out_of_range_is_named(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{field} must be"):
        ModulesConfig(**{field: value})
