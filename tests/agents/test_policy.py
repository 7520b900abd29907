"""A policy on disk: read without running code, refused if it is not one."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from agents.policy import CARD, WEIGHTS, Policy, PolicyCard, load_policy, make_network, save_policy
from surface_gym.settings import Settings

THE_CARD = PolicyCard("SmartSurface/Sort-v0", "halves", 0.04, (8,))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_policy(make_network(THE_CARD, Settings(actions="halves")), THE_CARD, tmp_path)
    return tmp_path


def test_a_round_trip_predicts_the_same(tmp_path: Path) -> None:
    network = make_network(THE_CARD, Settings(actions="halves"))
    save_policy(network, THE_CARD, tmp_path)
    before, after = Policy(network, THE_CARD), load_policy(tmp_path)
    observations = np.random.default_rng(0).normal(size=(50, 15)).astype(np.float32)
    actions, _ = after.predict(observations)
    np.testing.assert_array_equal(actions, before.predict(observations)[0])
    assert len(set(actions.tolist())) > 1
    assert after.predict(observations[0])[0] == actions[0]
    assert (after.env_id, after.env_kwargs) == (before.env_id, before.env_kwargs)


class _Trap:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.mark,))


def test_a_pickle_is_refused_and_not_run(folder: Path) -> None:
    mark = folder / "ran"
    (folder / WEIGHTS).write_bytes(pickle.dumps(_Trap(mark), protocol=2))
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_policy(folder)
    assert not mark.exists()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[1, 2",
        "hidden: 3",
        "!!python/object/apply:os.system ['true']",
        "env_id: Other-v0\nactions: halves\ncontrol_period: 0.04\nhidden: [8]",
        "env_id: SmartSurface/Sort-v0\nactions: thirds\ncontrol_period: 0.04\nhidden: [8]",
        "env_id: SmartSurface/Sort-v0\nactions: halves\ncontrol_period: 0.04\nhidden: [9]",
        "env_id: SmartSurface/Sort-v0\nactions: halves\nhidden: [8]",
    ],
)
def test_a_foreign_card_is_refused(folder: Path, text: str) -> None:
    (folder / CARD).write_text(text)
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_policy(folder)


def test_damage_and_absence_are_named(folder: Path) -> None:
    whole = (folder / WEIGHTS).read_bytes()
    (folder / WEIGHTS).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="damaged"):
        load_policy(folder)
    (folder / WEIGHTS).unlink()
    with pytest.raises(ValueError, match=f"{WEIGHTS} is missing"):
        load_policy(folder)
