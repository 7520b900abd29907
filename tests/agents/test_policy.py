"""Policies on disk: they come back as they were, and no code in their files is run; and the
categorical distribution of Stable-Baselines3's networks, against Stable-Baselines3's own.
"""

import json
import pickle
import re
from hashlib import sha256
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
import yaml
from gymnasium import spaces
from stable_baselines3.common.distributions import MultiCategoricalDistribution
from stable_baselines3.common.policies import ActorCriticPolicy

from surface_gym.agents.library import CARD, WEIGHTS, PolicyCard
from surface_gym.agents.module_policy import ModulePolicy, SharedNetwork
from surface_gym.agents.policy import (
    EqualCategoricals,
    EqualChoicesPolicy,
    Policy,
    load_policy,
    make_network,
    save_policy,
)
from surface_gym.core.actions import KINDS


def sign(folder: Path) -> None:
    """Give the card the digest that its fields and the weights have now."""
    fields = yaml.safe_load((folder / CARD).read_text())
    fields.pop("digest", None)
    content = json.dumps(fields, sort_keys=True).encode() + (folder / WEIGHTS).read_bytes()
    fields["digest"] = sha256(content).hexdigest()
    (folder / CARD).write_text(yaml.safe_dump(fields))


CARDS = {
    "ppo": PolicyCard("SmartSurface/Sort-v0", "ppo", "halves", 0.04, (8,)),
    "dqn": PolicyCard("SmartSurface/Stop-v0", "dqn", "halves", 0.04, (8, 9)),
    "modules": PolicyCard("SmartSurface/Sort-v0", "modules", "modules", 0.04, (8, 9)),
    **{
        f"ppo of {kind}": PolicyCard("SmartSurface/Sort-v0", "ppo", kind, 0.04, (8,))
        for kind in KINDS
    },
}


def policy_of(card: PolicyCard) -> Policy | ModulePolicy:
    """With random weights."""
    torch.manual_seed(0)
    if card.algo == "modules":
        network = SharedNetwork(4, card.hidden)
        with torch.no_grad():
            for weights in network.parameters():
                weights.normal_()
        return ModulePolicy(network, card)
    config = card.env_config()
    return Policy(make_network(card, config), card, config)


@pytest.fixture(params=["ppo", "dqn", "modules"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    card = CARDS[request.param]
    save_policy(policy_of(card)._network, card, tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", CARDS)
def test_a_round_trip_predicts_what_an_environment_takes(name, tmp_path) -> None:
    before = policy_of(CARDS[name])
    save_policy(before._network, CARDS[name], tmp_path)
    after = load_policy(tmp_path)
    assert after.card == CARDS[name]
    assert (after.env_id, after.env_kwargs) == (before.env_id, before.env_kwargs)
    envs = gym.make_vec(after.env_id, num_envs=50, **after.env_kwargs)
    seen, _ = envs.reset(seed=0)
    actions, state = after.predict(seen)
    assert state is None
    assert actions in envs.action_space
    assert after.predict(seen[0])[0] in envs.single_action_space
    random = np.random.default_rng(0).normal(size=seen.shape).astype(np.float32)
    actions, _ = after.predict(random)
    np.testing.assert_array_equal(actions, before.predict(random)[0])
    assert len(np.unique(actions)) > 1
    for one, action in zip(random[:5], actions, strict=False):
        np.testing.assert_array_equal(after.predict(one)[0], action)


@pytest.mark.parametrize("name", [WEIGHTS, CARD])
def test_no_byte_can_change_unnoticed(folder, name) -> None:
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
    ("change", "message"),
    [
        (lambda weights: weights.to(torch.complex64), "must be torch.float32, got torch.complex64"),
        (lambda weights: weights.to(torch.float64), "must be torch.float32, got torch.float64"),
        (lambda weights: weights * torch.nan, "must be finite"),
        (lambda weights: weights[:-1], "size mismatch"),
        (lambda weights: weights.tolist(), "has no attribute 'dtype'"),
        (None, "is missing"),
    ],
    ids=["complex", "double", "nan", "short", "a list", "none"],
)
def test_weights_of_another_kind_are_refused(folder, change, message) -> None:
    weights = torch.load(folder / WEIGHTS, weights_only=True)
    name = next(iter(weights))
    first = weights.pop(name)
    torch.save(weights if change is None else {**weights, name: change(first)}, folder / WEIGHTS)
    sign(folder)
    with pytest.raises(ValueError, match=re.escape(message)):
        load_policy(folder)


class Trap:
    """Code that a pickle would run: it leaves a mark."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.mark,))


def test_a_pickle_is_refused_and_not_run(folder) -> None:
    mark = folder / "ran"
    (folder / WEIGHTS).write_bytes(pickle.dumps(Trap(mark), protocol=2))
    sign(folder)
    with pytest.raises(ValueError, match=r"it holds more than tensors and plain values$"):
        load_policy(folder)
    assert not mark.exists()


@pytest.mark.parametrize(
    "text", ["", "[1, 2", "hidden: [8]", "!!python/object/apply:os.system ['true']"]
)
def test_a_foreign_card_is_refused(folder, text) -> None:
    (folder / CARD).write_text(text)
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_policy(folder)


@pytest.mark.parametrize(
    "wrong",
    [
        "env_id: Other-v0", "env_id: SmartSurface/Slow-v0", "algo: sac", "actions: thirds",
        "actions: window", "control_period: -1.0", "hidden: [9]", "hidden: []", "more: 1", "env_id",
        "algo", "actions", "control_period",
    ],
)  # fmt: skip
def test_a_card_of_other_weights_or_that_lacks_a_field_is_refused(folder, wrong) -> None:
    name, given, _ = wrong.partition(":")
    lines = (folder / CARD).read_text().splitlines()
    kept = [line for line in lines if not line.startswith((name, "-"))]
    (folder / CARD).write_text("\n".join([*kept, wrong] if given else kept))
    sign(folder)
    with pytest.raises(ValueError, match="damaged or foreign"):
        load_policy(folder)


def test_damage_and_absence_are_named(folder) -> None:
    whole, lines = (folder / WEIGHTS).read_bytes(), (folder / CARD).read_text().splitlines()
    (folder / CARD).write_text("\n".join(line for line in lines if not line.startswith("digest")))
    with pytest.raises(ValueError, match="'digest' is missing"):
        load_policy(folder)
    sign(folder)
    (folder / WEIGHTS).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="its digest differs"):
        load_policy(folder)
    sign(folder)
    with pytest.raises(ValueError, match="failed reading zip archive"):
        load_policy(folder)
    (folder / WEIGHTS).unlink()
    with pytest.raises(ValueError, match=f"{WEIGHTS} is missing"):
        load_policy(folder)


CHOICES, OPTIONS, NUM_ENVS = 25, 4, 7


@pytest.fixture
def logits() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return 2.0 * torch.randn((NUM_ENVS, CHOICES * OPTIONS), generator=generator)


def both(logits: torch.Tensor) -> tuple[EqualCategoricals, MultiCategoricalDistribution]:
    ours = EqualCategoricals(CHOICES, OPTIONS).proba_distribution(logits)
    return ours, MultiCategoricalDistribution([OPTIONS] * CHOICES).proba_distribution(logits)


def test_gradients_are_theirs(logits) -> None:
    actions = both(logits)[1].sample()
    gradients = []
    for of in (0, 1):
        leaf = logits.clone().requires_grad_()
        distribution = both(leaf)[of]
        (distribution.log_prob(actions).sum() + 0.1 * distribution.entropy().sum()).backward()
        gradients.append(leaf.grad)
    torch.testing.assert_close(gradients[0], gradients[1])


def test_samples_fall_as_often_as_they_should() -> None:
    """Each option's share lies within 5 standard errors of its probability."""
    torch.manual_seed(0)
    draws = 20_000
    row = torch.randn((1, CHOICES * OPTIONS), generator=torch.Generator().manual_seed(1))
    ours, theirs = both(row.expand(draws, -1))
    wanted = torch.stack([each.probs[0] for each in theirs.distribution])
    samples = ours.sample()
    assert samples.shape == (draws, CHOICES)
    share = torch.nn.functional.one_hot(samples, OPTIONS).double().mean(dim=0)
    error = (wanted * (1.0 - wanted) / draws).sqrt()
    assert bool(((share - wanted).abs() < 5.0 * error).all())


def test_a_policy_is_theirs_to_the_weights() -> None:
    observations, actions = spaces.Box(-1.0, 1.0, (3,)), spaces.MultiDiscrete([OPTIONS] * CHOICES)
    ours = EqualChoicesPolicy(observations, actions, lambda _: 1e-3, net_arch=[8])
    theirs = ActorCriticPolicy(observations, actions, lambda _: 1e-3, net_arch=[8])
    theirs.load_state_dict(ours.state_dict())
    assert isinstance(ours.action_dist, EqualCategoricals)
    seen = np.random.default_rng(0).normal(size=(NUM_ENVS, 3)).astype(np.float32)
    chosen, _ = ours.predict(seen, deterministic=True)
    np.testing.assert_array_equal(chosen, theirs.predict(seen, deterministic=True)[0])
    given = torch.from_numpy(seen), torch.from_numpy(chosen)
    for mine, other in zip(
        ours.evaluate_actions(*given), theirs.evaluate_actions(*given), strict=True
    ):
        torch.testing.assert_close(mine, other)
    single, _ = ours.predict(seen[0], deterministic=True)
    np.testing.assert_array_equal(single, chosen[0])


@pytest.mark.parametrize("space", [spaces.Discrete(4), spaces.MultiDiscrete([2, 3])])
def test_other_spaces_keep_their_distribution(space) -> None:
    policy = EqualChoicesPolicy(spaces.Box(-1.0, 1.0, (3,)), space, lambda _: 1e-3, net_arch=[8])
    assert not isinstance(policy.action_dist, EqualCategoricals)
