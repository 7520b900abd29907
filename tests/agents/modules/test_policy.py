"""The shared weights as a policy, in memory and on disk."""

import pickle
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents.modules.network import SharedNetwork
from agents.modules.policy import (
    CARD,
    WEIGHTS,
    ModulesCard,
    ModulesPolicy,
    load_modules,
    save_modules,
)

THE_CARD = ModulesCard(control_period=0.04, hidden=8)


def network(seed: int = 0) -> SharedNetwork:
    """Weights at random, each module's place included."""
    torch.manual_seed(seed)
    made = SharedNetwork(4, THE_CARD.hidden)
    with torch.no_grad():
        for weights in made.parameters():
            weights.normal_()
    return made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_modules(network(), THE_CARD, tmp_path)
    return tmp_path


def observations(zone: tuple[int, int] | None = None) -> np.ndarray:
    env = gym.make_vec("SmartSurface/Sort-v0", num_envs=12, zone=zone)
    seen, _ = env.reset(seed=0, options={"speed": 2.0})
    for _ in range(6):
        seen, *_ = env.step(np.full(env.action_space.shape, 3))
    return seen


def test_a_round_trip_predicts_the_same(folder: Path) -> None:
    before, after = ModulesPolicy(network(), THE_CARD), load_modules(folder)
    seen = observations()
    actions, state = after.predict(seen)
    np.testing.assert_array_equal(actions, before.predict(seen)[0])
    assert state is None
    assert len(np.unique(actions)) > 1
    assert after.card == THE_CARD
    assert after.env_id == "SmartSurface/Sort-v0"


@pytest.mark.parametrize("zone", [None, (3, 29), (5, 9)])
def test_it_takes_and_gives_what_an_environment_of_any_zone_does(
    folder: Path, zone: tuple[int, int] | None
) -> None:
    policy = load_modules(folder, zone)
    env = gym.make(policy.env_id, **policy.env_kwargs)
    observation, _ = env.reset(seed=0)
    assert policy.predict(observation)[0] in env.action_space
    seen = observations(zone)
    chosen, _ = policy.predict(seen)
    assert chosen in gym.make_vec(policy.env_id, num_envs=12, **policy.env_kwargs).action_space
    for lane, one in enumerate(seen):
        np.testing.assert_array_equal(policy.predict(one)[0], chosen[lane])
    np.testing.assert_array_equal(load_modules(folder).on(zone).predict(seen)[0], chosen)


def test_a_draw_is_shared_by_the_modules_of_a_lane() -> None:
    """Weights that know no place make modules alike: all of a lane choose alike, lanes do not."""
    alike = network()
    torch.nn.init.zeros_(alike._apart.weight)
    torch.nn.init.zeros_(alike._logits.weight)
    torch.nn.init.zeros_(alike._logits.bias)
    policy = ModulesPolicy(alike, THE_CARD)
    seen = observations()
    chosen = set()
    for _ in range(20):
        actions, _ = policy.predict(seen, deterministic=False)
        for lane in actions:
            told = set(lane.tolist()) - {3}
            assert len(told) <= 1
            chosen |= told
    assert chosen == {0, 1, 2}


class _Trap:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.mark,))


def test_a_pickle_is_refused_and_not_run(folder: Path) -> None:
    mark = folder / "ran"
    (folder / WEIGHTS).write_bytes(pickle.dumps(_Trap(mark), protocol=2))
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_modules(folder)
    assert not mark.exists()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[1, 2",
        "hidden: 8",
        "!!python/object/apply:os.system ['true']",
        "control_period: 0.04\nhidden: 9",
        "control_period: -1.0\nhidden: 8",
        "control_period: 0.04\nhidden: 8\nenv_id: SmartSurface/Slow-v0",
        "control_period: 0.04\nhidden: 8\nactions: halves",
    ],
)
def test_a_foreign_card_is_refused(folder: Path, text: str) -> None:
    (folder / CARD).write_text(text)
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_modules(folder)


def test_damage_and_absence_are_named(folder: Path) -> None:
    whole = (folder / WEIGHTS).read_bytes()
    (folder / WEIGHTS).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="damaged"):
        load_modules(folder)
    (folder / WEIGHTS).unlink()
    with pytest.raises(ValueError, match=f"{WEIGHTS} is missing"):
        load_modules(folder)
