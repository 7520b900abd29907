"""Parcels that learn: runs that are reproducible, and gone on from after a break."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import agents
from agents.flow.policy import FlowPolicy
from agents.learning.checkpoint import FILE as CHECKPOINT
from agents.learning.config import ParcelsConfig
from agents.learning.curve import FILE as CURVE
from agents.learning.parcels import CriticFirst
from agents.learning.training import train
from agents.policies.files import CARD, WEIGHTS
from tests.agents.signing import sign

SMALL = ParcelsConfig(
    steps=30_000, lanes=4, seats=8, n_steps=64, batch_size=512, n_epochs=1, hidden=(8,),
    imitation=0, critic_first=4_000, checkpoint_every=8_192,
)  # fmt: skip


def weights(folder: Path) -> dict[str, torch.Tensor]:
    found: dict[str, torch.Tensor] = torch.load(folder / WEIGHTS, weights_only=True)
    return found


def folder(tmp_path: Path, name: str) -> Path:
    made = tmp_path / name
    made.mkdir()
    return made


def test_a_run_broken_off_goes_on_to_the_same_weights_and_curve(tmp_path: Path) -> None:
    whole, broken = folder(tmp_path, "whole"), folder(tmp_path, "broken")
    train(SMALL, whole)

    def stop(steps: int, success: float) -> None:
        del success  # it may be nan still
        if steps > 12_000:
            raise KeyboardInterrupt

    assert train(SMALL, broken, stop).interrupted
    assert (broken / CHECKPOINT).is_file()
    train(SMALL, broken)
    assert (broken / CURVE).read_bytes() == (whole / CURVE).read_bytes()
    first, second = weights(whole), weights(broken)
    assert all(torch.equal(values, second[name]) for name, values in first.items())
    policy = agents.read(whole)
    assert isinstance(policy, FlowPolicy)
    assert policy.env_kwargs == {"actions": "parcels", "gate": True, "control_period": 0.04}


def test_the_actor_waits_for_the_critic(tmp_path: Path) -> None:
    made = folder(tmp_path, "waiting")
    config = replace(SMALL, steps=4_000, critic_first=1_000_000)
    train(config, made)
    untaught = folder(tmp_path, "untaught")
    train(replace(config, steps=1, learning_rate=1e-30), untaught)
    found, before = weights(made), weights(untaught)
    actor = [name for name in found if name.startswith(("action_net", "mlp_extractor.policy_net"))]
    assert actor
    assert all(torch.equal(found[name], before[name]) for name in actor)
    assert not torch.equal(found["value_net.weight"], before["value_net.weight"])
    assert CriticFirst(1)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"task": "sort"}, "task"),
        ({"actions": "halves"}, "actions"),
        ({"seats": 1, "batch_size": 64}, "seats"),
        ({"imitation": -1}, "imitation"),
        ({"clip_range": 0.0}, "clip_range"),
        ({"batch_size": 500}, "batch_size"),
    ],
)
def test_what_is_not_allowed_is_named(change: dict[str, object], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        replace(SMALL, **change)


def test_a_policy_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    made = folder(tmp_path, "made")
    train(replace(SMALL, steps=100), made)
    card = (made / CARD).read_text()
    (made / CARD).write_text(card.replace("algo: parcels", "algo: ppo"))
    sign(made)
    with pytest.raises(ValueError, match="algo must be 'parcels'"):
        agents.read(made)


def test_an_observation_of_one_flow_or_of_many(tmp_path: Path) -> None:
    made = folder(tmp_path, "made")
    train(replace(SMALL, steps=100), made)
    policy = agents.read(made)
    tables = np.random.default_rng(0).random((3, 25, 29), dtype=np.float32)
    tables[..., 15] = 1.0
    tables[..., 14] = -1.0
    many, _ = policy.predict(tables)
    assert many.shape == (3, 49)
    assert np.array_equal(policy.predict(tables[1])[0], many[1])
