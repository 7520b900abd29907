"""Policies on disk come back as they were, and no code in files is run; their distributions."""

import json
import pickle
import re
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import yaml
from gymnasium import spaces
from safetensors.torch import load_file, save_file
from stable_baselines3.common.policies import ActorCriticPolicy

from surface_gym import agents
from surface_gym.actions import KINDS
from surface_gym.agents import policy as policies
from surface_gym.agents.base import SIDE
from surface_gym.agents.library import CARD, OLD_WEIGHTS, WEIGHTS, PolicyCard, save_policy
from surface_gym.agents.module_policy import ModulePolicy, make_actor
from surface_gym.agents.schedule_policy import ScheduleNetwork, SchedulePolicy
from surface_gym.agents.scheduling import scheduler
from surface_gym.flow.task import COLUMN
from surface_gym.tasks import Sort
from surface_gym.tasks.features import compute_digest


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


def policy_of(card: PolicyCard) -> policies.Policy | ModulePolicy:
    torch.manual_seed(0)
    config, is_modules = card.env_config(), card.algo == "modules"
    network: Any = (
        make_actor(config, card.hidden) if is_modules else policies.make_network(card, config)
    )
    with torch.no_grad():
        for weights in network.parameters():
            weights.normal_(std=0.5)
    return ModulePolicy(network, card) if is_modules else policies.Policy(network, card, config)


@pytest.fixture(params=["ppo", "dqn", "modules"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    card = CARDS[request.param]
    save_policy(policy_of(card)._network.state_dict(), card, tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", CARDS)
def test_a_round_trip_predicts_what_an_environment_takes(name, tmp_path) -> None:
    before = policy_of(CARDS[name])
    save_policy(before._network.state_dict(), CARDS[name], tmp_path)
    after = agents.read(tmp_path)
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
    random[7, 0] = np.nan
    for wrong in (random, None, "left"):
        with pytest.raises(ValueError, match=r"observation must be .*, got (nan|None|'left')"):
            after.predict(wrong)
    for one, action in zip(random[:5], actions, strict=False):
        np.testing.assert_array_equal(after.predict(one)[0], action)


def test_a_policy_of_other_features_or_scales_is_refused_and_an_older_card_is_not(tmp_path) -> None:
    names = [replace(each, meaning="another text", high=99.0) for each in Sort.features]
    for features, same in (
        ("", True),
        (compute_digest(names), True),
        (compute_digest([*names[1:], names[0]]), False),
        (compute_digest([replace(names[0], scale=0.4), *names[1:]]), False),
    ):
        card = replace(CARDS["ppo"], features=features)
        save_policy(policy_of(CARDS["ppo"])._network.state_dict(), card, tmp_path)
        if same:
            assert agents.read(tmp_path).card == card
        else:
            message = f"features must be '{features}', .* as it is now; train the policy again"
            with pytest.raises(ValueError, match=message):
                agents.read(tmp_path)
    fields = yaml.safe_load((tmp_path / CARD).read_text())
    assert fields["features"] == features


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda weights: weights.to(torch.complex64),
            "must have the type torch.float32, got torch.complex64",
        ),
        (
            lambda weights: weights.to(torch.float64),
            "must have the type torch.float32, got torch.float64",
        ),
        (lambda weights: weights * torch.nan, "must be finite"),
        (lambda weights: weights[:-1], "must have the shape ("),
        (None, "is missing"),
    ],
    ids=["complex", "double", "nan", "short", "none"],
)
def test_weights_of_another_kind_are_refused(folder, change, message) -> None:
    weights = load_file(folder / WEIGHTS)
    name = next(iter(weights))
    first = weights.pop(name)
    changed = weights if change is None else {**weights, name: change(first).contiguous()}
    save_file(changed, folder / WEIGHTS)
    sign(folder)
    with pytest.raises(ValueError, match=re.escape(message)):
        agents.read(folder)


class Trap:
    """Code that a pickle would run: it leaves a mark."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.mark,))


def test_a_pickle_is_refused_and_not_run(folder) -> None:
    mark = folder / "ran"
    torch.save({"a": Trap(mark)}, folder / WEIGHTS)
    sign(folder)
    with pytest.raises(ValueError, match=r"it holds more than tensors and plain values$"):
        agents.read(folder)
    (folder / WEIGHTS).write_bytes(pickle.dumps(Trap(mark), protocol=2))
    sign(folder)
    with pytest.raises(ValueError, match=f"damaged or foreign policy: {WEIGHTS}: "):
        agents.read(folder)
    assert not mark.exists()


def test_a_policy_of_an_earlier_version_is_read(folder) -> None:
    """Its weights are in an archive of PyTorch's."""
    now, earlier = agents.read(folder), folder / OLD_WEIGHTS
    torch.save(load_file(folder / WEIGHTS), earlier)
    earlier.replace(folder / WEIGHTS)
    sign(folder)
    (folder / WEIGHTS).replace(earlier)
    before = agents.read(folder)
    assert before.card == now.card
    weights = now._network.state_dict()
    for name, each in before._network.state_dict().items():
        assert torch.equal(each, weights[name])


@pytest.mark.parametrize(
    "wrong",
    [
        "env_id: Other-v0", "env_id: SmartSurface/Slow-v0", "algo: sac", "actions: thirds",
        "actions: window", "control_period: -1.0", "hidden: [9]", "hidden: []",
        "hidden: [60000, 60000]", f"hidden: {[1] * 5000}", "more: 1", "env_id", "algo", "actions",
        "control_period",
    ],
)  # fmt: skip
def test_a_card_of_other_weights_or_that_lacks_a_field_is_refused(folder, wrong) -> None:
    name, given, _ = wrong.partition(":")
    lines = (folder / CARD).read_text().splitlines()
    kept = [line for line in lines if not line.startswith((name, "-"))]
    (folder / CARD).write_text("\n".join([*kept, wrong] if given else kept))
    sign(folder)
    with pytest.raises(ValueError, match="damaged or foreign"):
        agents.read(folder)


def test_other_weights_and_their_absence_are_named(folder) -> None:
    (folder / WEIGHTS).write_bytes((folder / WEIGHTS).read_bytes()[:100])
    with pytest.raises(ValueError, match="its digest differs"):
        agents.read(folder)
    (folder / WEIGHTS).unlink()
    with pytest.raises(ValueError, match=f"{WEIGHTS} is missing"):
        agents.read(folder)


CHOICES, OPTIONS = 25, 4


def test_samples_fall_as_often_as_they_should() -> None:
    """Each option's share lies within 5 standard errors of its probability."""
    torch.manual_seed(0)
    draws = 20_000
    row = torch.randn((1, CHOICES * OPTIONS), generator=torch.Generator().manual_seed(1))
    wanted = row.reshape(CHOICES, OPTIONS).softmax(dim=1)
    ours = policies.EqualCategoricals(CHOICES, OPTIONS).proba_distribution(row.expand(draws, -1))
    samples = ours.sample()
    assert samples.shape == (draws, CHOICES)
    share = torch.nn.functional.one_hot(samples, OPTIONS).double().mean(dim=0)
    error = (wanted * (1.0 - wanted) / draws).sqrt()
    assert bool(((share - wanted).abs() < 5.0 * error).all())


def test_a_policy_is_theirs_to_the_weights_and_gradients() -> None:
    observations, actions = spaces.Box(-1.0, 1.0, (3,)), spaces.MultiDiscrete([OPTIONS] * CHOICES)
    ours = policies.EqualChoicesPolicy(observations, actions, lambda _: 1e-3, net_arch=[8])
    theirs = ActorCriticPolicy(observations, actions, lambda _: 1e-3, net_arch=[8])
    theirs.load_state_dict(ours.state_dict())
    assert isinstance(ours.action_dist, policies.EqualCategoricals)
    seen = np.random.default_rng(0).normal(size=(7, 3)).astype(np.float32)
    chosen, _ = ours.predict(seen, deterministic=True)
    np.testing.assert_array_equal(chosen, theirs.predict(seen, deterministic=True)[0])
    np.testing.assert_array_equal(ours.predict(seen[0], deterministic=True)[0], chosen[0])
    random = actions.sample()[None].repeat(7, axis=0)
    for some in (chosen, random):
        results: list[tuple[torch.Tensor, ...]] = []
        for policy in (ours, theirs):
            policy.zero_grad()
            found = policy.evaluate_actions(torch.from_numpy(seen), torch.from_numpy(some))
            sum(part.sum() * (k + 1) for k, part in enumerate(found)).backward()
            results.append(found)
        for mine, other in zip(*results, strict=True):
            torch.testing.assert_close(mine, other)
        for mine, other in zip(ours.parameters(), theirs.parameters(), strict=True):
            torch.testing.assert_close(mine.grad, other.grad)


@pytest.mark.parametrize("space", [spaces.Discrete(4), spaces.MultiDiscrete([2, 3])])
def test_other_spaces_keep_their_distribution(space) -> None:
    policy = policies.EqualChoicesPolicy(
        spaces.Box(-1.0, 1.0, (3,)), space, lambda _: 1e-3, net_arch=[8]
    )
    assert not isinstance(policy.action_dist, policies.EqualCategoricals)


FLOW_CARD = PolicyCard("SmartSurface/Flow-v0", "schedule", "parcels", 0.04, (8,))


@pytest.fixture
def flow_folder(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_policy(ScheduleNetwork(FLOW_CARD.hidden).state_dict(), FLOW_CARD, tmp_path)
    return tmp_path


def test_a_policy_file_of_another_kind_is_refused(flow_folder) -> None:
    card = (flow_folder / CARD).read_text()
    (flow_folder / CARD).write_text(card.replace("algo: schedule", "algo: ppo"))
    sign(flow_folder)
    with pytest.raises(ValueError, match="task must be one of a single parcel for PPO, got 'flow'"):
        agents.read(flow_folder)


def test_an_observation_of_one_stream_or_of_many(flow_folder, monkeypatch) -> None:
    monkeypatch.setattr(scheduler, "TRIAL", 2.0)
    policy = agents.read(flow_folder)
    assert isinstance(policy, SchedulePolicy)
    assert policy.env_kwargs == {
        "actions": "parcels", "gate": True, "queue": 4, "control_period": 0.04,
    }  # fmt: skip
    tables = np.random.default_rng(0).random((3, 28, 29), dtype=np.float32)
    tables[..., COLUMN.present.place] = np.arange(28) < 6  # rows of parcels
    tables[..., SIDE] = -1.0
    many, _ = policy.predict(tables)
    assert many.shape == (3, 49)
    assert np.array_equal(policy.predict(tables[1])[0], many[1])
    for wrong, message in (
        (np.nan * tables, "be finite, got nan"),
        (tables[0, 0], "have the shape"),
    ):
        with pytest.raises(ValueError, match=f"observation must {message}"):
            policy.predict(wrong)
