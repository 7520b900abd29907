"""A policy on disk: read without running code, refused if it is not one."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from agents.policies.files import load_policy, save_policy
from agents.policies.policy import make_network
from agents.policy_card import PolicyCard
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS

CARDS = [
    PolicyCard(env_id(task), algo, actions, 0.04, (8,))
    for task in TASKS
    for algo, actions in (("ppo", "halves"), ("ppo", "quadrants"), ("dqn", "halves"))
] + [PolicyCard(env_id("sort"), "ppo", actions, 0.04, (8,)) for actions in ("modules", "window")]


@pytest.mark.parametrize("card", CARDS, ids=lambda card: f"{card.task} {card.algo} {card.actions}")
def test_it_takes_and_gives_what_its_environment_does(tmp_path: Path, card: PolicyCard) -> None:
    save_policy(make_network(card, card.settings()), card, tmp_path)
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
