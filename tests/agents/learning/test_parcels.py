"""Training of parcels: agent slots, each of which follows one parcel from the gate until it has
left, and the order in which networks learn.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from surface_gym.agents.base import SIDE
from surface_gym.agents.learning.config import ParcelsConfig
from surface_gym.agents.learning.parcels import SlotVecEnv, densest_stream, training_env_config
from surface_gym.agents.learning.runs import train
from surface_gym.agents.library import WEIGHTS
from surface_gym.agents.rules.streams import StreamEventRule
from surface_gym.config import EnvConfig
from surface_gym.flow.task import PRESENT, WAITS

SMALL = ParcelsConfig(
    steps=4_000, num_envs=4, slots=8, n_steps=64, batch_size=512, n_epochs=1, hidden=(8,),
    imitation=0, critic_first=4_000, checkpoint_every=8_192,
)  # fmt: skip
CONFIG = training_env_config(0.04)
SLOTS = 14


def make_slots(num_streams: int = 2, seed: int = 0) -> SlotVecEnv:
    env = SlotVecEnv(CONFIG, num_streams, SLOTS, lambda _: densest_stream(1.5, ("S", "B")))
    env.seed(seed)
    return env


@pytest.fixture(scope="module")
def run() -> list[tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, object]]]]:
    """Observations, rewards, ends and infos of 150 periods; all parcels obey the event rule."""
    env = make_slots()
    rule = StreamEventRule(EnvConfig("flow", exits="sides", actions="parcels"))
    seen = np.asarray(env.reset())
    steps = []
    for _ in range(150):
        choices = np.ones((env.num_envs, 3), dtype=np.int64)
        there = (seen[:, PRESENT] > 0.5) & (seen[:, WAITS] < 0.5)
        if there.any():
            choices[there, :2] = rule.halves(seen[there])
        after, rewards, ends, infos = env.step(choices)
        steps.append((seen, rewards, ends, infos))
        seen = np.asarray(after)
    return steps


def test_a_parcel_keeps_its_slot_until_it_has_left(run) -> None:
    for (seen, _, ends, _), (after, *_) in pairwise(run):
        sat, sits = seen[:, PRESENT] > 0.5, after[:, PRESENT] > 0.5
        # No parcel changes slots: one that stays has moved by no more than a period's way.
        stays = sat & sits & ~ends
        way = np.abs(after[stays, 13] - seen[stays, 13])
        assert way.max(initial=0.0) < 0.25
        assert not (sat & ~sits & ~ends).any()


def test_every_parcel_that_leaves_by_its_exit_is_a_success(run) -> None:
    ended = [info for *_, infos in run for info in infos if info]
    assert len(ended) > 20
    assert all(info["is_success"] for info in ended if not info["TimeLimit.truncated"])


def test_a_free_slot_observes_and_earns_nothing(run) -> None:
    for seen, rewards, _, _ in run:
        free = seen[:, PRESENT] < 0.5
        assert not seen[free].any()
        assert not rewards[free].any()


def test_the_observed_side_is_mirrored(run) -> None:
    assert all((seen[:, SIDE] >= 0.0).all() for seen, *_ in run)


def test_the_same_seed_gives_the_same_parcels() -> None:
    one, other = make_slots(seed=4), make_slots(seed=4)
    rng = np.random.default_rng(0)
    assert np.array_equal(one.reset(), other.reset())
    for _ in range(30):
        choices = rng.integers(0, [4, 4, 9], (one.num_envs, 3))
        for first, second in zip(one.step(choices)[:3], other.step(choices)[:3], strict=True):
            assert np.array_equal(first, second)


def test_the_actor_waits_for_the_critic(tmp_path) -> None:
    made, untaught = tmp_path / "waiting", tmp_path / "untaught"
    config = replace(SMALL, critic_first=1_000_000)
    for folder in (made, untaught):
        folder.mkdir()
    train(config, made)
    train(replace(config, steps=1, learning_rate=1e-30), untaught)
    found, before = (torch.load(folder / WEIGHTS, weights_only=True) for folder in (made, untaught))
    actor = [name for name in found if name.startswith(("action_net", "mlp_extractor.policy_net"))]
    assert actor
    assert all(torch.equal(found[name], before[name]) for name in actor)
    assert not torch.equal(found["value_net.weight"], before["value_net.weight"])
