"""A policy on disk: read without running code, refused if it is not one."""

import pickle
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from agents.policy import CARD, WEIGHTS, Policy, PolicyCard, load_policy, make_network, save_policy
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS

THE_CARD = PolicyCard("SmartSurface/Sort-v0", "ppo", "halves", 0.04, (8,))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_policy(make_network(THE_CARD), THE_CARD, tmp_path)
    return tmp_path


def test_a_round_trip_predicts_the_same(tmp_path: Path) -> None:
    network = make_network(THE_CARD)
    save_policy(network, THE_CARD, tmp_path)
    before, after = Policy(network, THE_CARD), load_policy(tmp_path)
    observations = np.random.default_rng(0).normal(size=(50, 15)).astype(np.float32)
    actions, _ = after.predict(observations)
    np.testing.assert_array_equal(actions, before.predict(observations)[0])
    assert len(set(actions.tolist())) > 1
    assert after.predict(observations[0])[0] == actions[0]
    assert (after.env_id, after.env_kwargs) == (before.env_id, before.env_kwargs)


CARDS = [
    PolicyCard(env_id(task), algo, actions, 0.04, (8,))
    for task in TASKS
    for algo, actions in (("ppo", "halves"), ("ppo", "quadrants"), ("dqn", "halves"))
] + [PolicyCard(env_id("sort"), "ppo", actions, 0.04, (8,)) for actions in ("modules", "window")]


@pytest.mark.parametrize("card", CARDS, ids=lambda card: f"{card.task} {card.algo} {card.actions}")
def test_it_takes_and_gives_what_its_environment_does(tmp_path: Path, card: PolicyCard) -> None:
    save_policy(make_network(card), card, tmp_path)
    policy = load_policy(tmp_path)
    assert policy.card == card
    env = gym.make(policy.env_id, **policy.env_kwargs)
    observation, _ = env.reset(seed=0)
    assert policy.predict(observation)[0] in env.action_space
    vector = gym.make_vec(policy.env_id, num_envs=5, **policy.env_kwargs)
    observations, _ = vector.reset(seed=0)
    chosen, _ = policy.predict(observations)
    assert chosen in vector.action_space
    for lane, one in enumerate(observations):
        np.testing.assert_array_equal(policy.predict(one)[0], chosen[lane])


def test_any_damage_is_refused_or_without_effect_on_what_runs(folder: Path) -> None:
    """Bytes changed at random: what still loads is a policy, all else a ValueError."""
    whole = (folder / WEIGHTS).read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(60):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            damaged[place] = rng.integers(256)
        (folder / WEIGHTS).write_bytes(damaged)
        try:
            assert isinstance(load_policy(folder), Policy)
        except ValueError:
            refused += 1
    assert refused > 0


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


WHOLE = (
    "env_id: SmartSurface/Sort-v0\nalgo: ppo\nactions: halves\ncontrol_period: 0.04\nhidden: [8]"
)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[1, 2",
        "hidden: 3",
        "!!python/object/apply:os.system ['true']",
        WHOLE.replace("SmartSurface/Sort-v0", "Other-v0"),
        WHOLE.replace("ppo", "sac"),
        WHOLE.replace("halves", "thirds"),
        WHOLE.replace("[8]", "[9]"),
        WHOLE.replace("control_period: 0.04\n", ""),
        WHOLE + "\nmore: 1",
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
