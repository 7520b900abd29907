"""The shared weights as a policy, in memory and on disk."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents.modules.network import SharedNetwork
from agents.modules.policy import ModulesPolicy
from agents.policy_card import PolicyCard
from surface_gym.core.actions import group_features

THE_CARD = PolicyCard("SmartSurface/Sort-v0", "modules", "modules", 0.04, (8, 8))


def network(seed: int = 0, observe: tuple[str, ...] = ()) -> SharedNetwork:
    """Weights at random, each module's place included."""
    torch.manual_seed(seed)
    made = SharedNetwork(4, THE_CARD.hidden, observe)
    with torch.no_grad():
        for weights in made.parameters():
            weights.normal_()
    return made


def observations(zone: tuple[int, int] | None = None) -> np.ndarray:
    env = gym.make_vec("SmartSurface/Sort-v0", num_envs=12, zone=zone)
    seen, _ = env.reset(seed=0, options={"speed": 2.0})
    for _ in range(6):
        seen, *_ = env.step(np.full(env.action_space.shape, 3))
    return seen


@pytest.mark.parametrize("zone", [None, (3, 29), (5, 9)])
def test_it_takes_and_gives_what_an_environment_of_any_zone_does(
    zone: tuple[int, int] | None,
) -> None:
    policy = ModulesPolicy(network(), THE_CARD).on(zone)
    env = gym.make(policy.env_id, **policy.env_kwargs)
    observation, _ = env.reset(seed=0)
    assert policy.predict(observation)[0] in env.action_space
    seen = observations(zone)
    chosen, _ = policy.predict(seen)
    assert chosen in gym.make_vec(policy.env_id, num_envs=12, **policy.env_kwargs).action_space
    for lane, one in enumerate(seen):
        np.testing.assert_array_equal(policy.predict(one)[0], chosen[lane])


@pytest.mark.parametrize("observe", [("parcel",), ("rotors",), ("parcel", "rotors")])
def test_it_sees_what_its_card_says(observe: tuple[str, ...]) -> None:
    policy = ModulesPolicy(network(observe=observe), replace(THE_CARD, observe=observe))
    env = gym.make_vec(policy.env_id, num_envs=12, **policy.env_kwargs)
    seen, _ = env.reset(seed=0)
    actions, _ = policy.predict(seen)
    assert actions in env.action_space
    assert seen.shape[1] == 15 + len(group_features(observe))


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
