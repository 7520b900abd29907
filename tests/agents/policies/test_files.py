"""Policies on disk: they come back as they were, and nothing in their files is run."""

import pickle
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from agents.modules.network import SharedNetwork
from agents.modules.policy import ModulesPolicy
from agents.policies.files import CARD, WEIGHTS, load_policy, save_policy
from agents.policies.policy import Policy, make_network
from agents.policy_card import PolicyCard
from tests.agents.signing import sign

CARDS = {
    "ppo": PolicyCard("SmartSurface/Sort-v0", "ppo", "halves", 0.04, (8,)),
    "dqn": PolicyCard("SmartSurface/Stop-v0", "dqn", "halves", 0.04, (8, 9)),
    "modules": PolicyCard("SmartSurface/Sort-v0", "modules", "modules", 0.04, (8, 9)),
}


def policy_of(card: PolicyCard) -> Policy | ModulesPolicy:
    """With weights at random."""
    torch.manual_seed(0)
    if card.algo == "modules":
        network = SharedNetwork(4, card.hidden)
        with torch.no_grad():
            for weights in network.parameters():
                weights.normal_()
        return ModulesPolicy(network, card)
    settings = card.settings()
    return Policy(make_network(card, settings), card, settings)


@pytest.fixture(params=CARDS)
def card(request: pytest.FixtureRequest) -> PolicyCard:
    return CARDS[request.param]


@pytest.fixture
def folder(tmp_path: Path, card: PolicyCard) -> Path:
    save_policy(policy_of(card)._network, card, tmp_path)
    return tmp_path


def test_a_round_trip_predicts_the_same(folder: Path, card: PolicyCard) -> None:
    before, after = policy_of(card), load_policy(folder)
    features = card.settings().observation_space().shape[0]
    observations = np.random.default_rng(0).normal(size=(50, features)).astype(np.float32)
    actions, state = after.predict(observations)
    np.testing.assert_array_equal(actions, before.predict(observations)[0])
    assert state is None
    assert len(np.unique(actions)) > 1
    np.testing.assert_array_equal(after.predict(observations[0])[0], actions[0])
    assert after.card == card
    assert (after.env_id, after.env_kwargs) == (before.env_id, before.env_kwargs)


@pytest.mark.parametrize("name", [WEIGHTS, CARD])
def test_no_byte_can_change_unnoticed(folder: Path, name: str) -> None:
    whole = (folder / name).read_bytes()
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(whole), 60):
        changed = bytearray(whole)
        changed[place] ^= 1 << int(rng.integers(8))
        (folder / name).write_bytes(changed)
        if name == CARD and yaml_of(bytes(changed)) == yaml_of(whole):
            continue  # white space
        with pytest.raises(ValueError, match="damaged or foreign"):
            load_policy(folder)


def yaml_of(content: bytes) -> object:
    try:
        return yaml.safe_load(content.decode())
    except (UnicodeDecodeError, yaml.YAMLError):
        return None


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda weights: weights.to(torch.complex64), "must be torch.float32, got torch.complex64"),
        (lambda weights: weights.to(torch.float64), "must be torch.float32, got torch.float64"),
        (lambda weights: weights * torch.nan, "must be finite"),
        (lambda weights: weights[:-1], "size mismatch"),
        (lambda weights: weights.tolist(), "has no attribute 'dtype'"),
    ],
    ids=["complex", "double", "nan", "short", "a list"],
)
def test_weights_of_another_kind_are_refused(
    folder: Path, change: Callable[[torch.Tensor], object], told: str
) -> None:
    weights = torch.load(folder / WEIGHTS, weights_only=True)
    name = next(iter(weights))
    torch.save({**weights, name: change(weights[name])}, folder / WEIGHTS)
    sign(folder)
    with pytest.raises(ValueError, match=re.escape(told)):
        load_policy(folder)


def test_weights_that_lack_a_layer_are_refused(folder: Path) -> None:
    weights = torch.load(folder / WEIGHTS, weights_only=True)
    name = next(iter(weights))
    del weights[name]
    torch.save(weights, folder / WEIGHTS)
    sign(folder)
    with pytest.raises(ValueError, match=f"'{re.escape(name)}' is missing"):
        load_policy(folder)


class _Trap:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.mark,))


def test_a_pickle_is_refused_and_not_run(folder: Path) -> None:
    mark = folder / "ran"
    (folder / WEIGHTS).write_bytes(pickle.dumps(_Trap(mark), protocol=2))
    sign(folder)
    with pytest.raises(ValueError, match=r"it holds more than tensors and plain values$"):
        load_policy(folder)
    assert not mark.exists()


@pytest.mark.parametrize(
    "text", ["", "[1, 2", "hidden: [8]", "!!python/object/apply:os.system ['true']"]
)
def test_a_foreign_card_is_refused(folder: Path, text: str) -> None:
    (folder / CARD).write_text(text)
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_policy(folder)


@pytest.mark.parametrize(
    "wrong",
    [
        "env_id: Other-v0",
        "env_id: SmartSurface/Slow-v0",
        "algo: sac",
        "actions: thirds",
        "actions: window",
        "control_period: -1.0",
        "hidden: [9]",
        "hidden: []",
        "more: 1",
    ],
)
def test_a_card_of_other_weights_is_refused(folder: Path, wrong: str) -> None:
    name = wrong.split(":")[0]
    lines = (folder / CARD).read_text().splitlines()
    kept = [line for line in lines if not line.startswith((name, "-"))]
    (folder / CARD).write_text("\n".join([*kept, wrong]))
    sign(folder)
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_policy(folder)


def test_a_card_without_a_digest_is_refused(folder: Path) -> None:
    lines = (folder / CARD).read_text().splitlines()
    (folder / CARD).write_text("\n".join(line for line in lines if not line.startswith("digest")))
    with pytest.raises(ValueError, match="'digest' is missing"):
        load_policy(folder)


@pytest.mark.parametrize("name", ["env_id", "algo", "actions", "control_period"])
def test_a_card_that_lacks_a_field_is_refused(folder: Path, name: str) -> None:
    lines = (folder / CARD).read_text().splitlines()
    (folder / CARD).write_text("\n".join(line for line in lines if not line.startswith(name)))
    sign(folder)
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_policy(folder)


def test_damage_and_absence_are_named(folder: Path) -> None:
    whole = (folder / WEIGHTS).read_bytes()
    (folder / WEIGHTS).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="its digest differs"):
        load_policy(folder)
    sign(folder)
    with pytest.raises(ValueError, match="failed reading zip archive"):
        load_policy(folder)
    (folder / WEIGHTS).unlink()
    with pytest.raises(ValueError, match=f"{WEIGHTS} is missing"):
        load_policy(folder)
