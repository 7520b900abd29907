"""The policy over modules for Stable-Baselines3."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

import surface_gym as sg
from surface_gym import agents
from surface_gym.agents.policy import GridPlaces, SharedDraws
from surface_gym.config import EnvConfig, ModuleChoices


def make_draws(seed: int = 0, modules: int = 5, choices: int = 4) -> SharedDraws:
    """Make a distribution of two environments, with a module far from the parcel in each."""
    torch.manual_seed(seed)
    each = torch.randn(2, modules, choices).log_softmax(dim=2)
    group = torch.tensor([[0, 0, 1, 1, -1], [0, 1, 1, -1, 1]])[:, :modules]
    flat = torch.cat([each, group.unsqueeze(2).float()], dim=2).flatten(1)
    return SharedDraws(modules, choices).proba_distribution(flat)


class TestSharedDraws:
    def test_likelihoods_are_the_shares_of_draws(self) -> None:
        draws = make_draws()
        samples = torch.stack([draws.sample() for _ in range(20_000)]).numpy()
        near = [0, 1, 2, 3]  # of the first environment
        seen, counts = np.unique(samples[:, 0, near], axis=0, return_counts=True)
        for choice, count in zip(seen, counts, strict=True):
            actions = torch.zeros(2, 5)
            actions[0, near] = torch.from_numpy(choice).float()
            share = float(draws.log_prob(actions)[0].exp())
            assert count / len(samples) == pytest.approx(share, abs=0.012)
        assert len(seen) > 4

    def test_modules_alike_choose_alike(self) -> None:
        flat = make_draws()
        flat._log_probability[:] = flat._log_probability[:, :1].clone()
        for _ in range(20):
            drawn = flat.sample()[0]
            assert drawn[0] == drawn[1]
            assert drawn[2] == drawn[3]

    def test_choices_that_no_number_gives_have_no_gradient(self) -> None:
        torch.manual_seed(0)
        each = torch.zeros(1, 2, 4, requires_grad=True)
        flat = torch.cat([each.log_softmax(dim=2), torch.zeros(1, 2, 1)], dim=2).flatten(1)
        draws = SharedDraws(2, 4).proba_distribution(flat)
        draws.log_prob(torch.tensor([[0, 3]])).sum().backward()
        assert each.grad is not None
        assert (each.grad == 0.0).all()


@pytest.mark.parametrize("task", ["sort", "stop"])
def test_groups_are_the_halves_of_the_environment(task: str) -> None:
    config = EnvConfig(task=task)
    halves = sg.SmartSurfaceVectorEnv(task=task, num_envs=16, actions="halves")
    observations, _ = halves.reset(seed=0)
    for _ in range(12):
        observations, *_ = halves.step(np.full(16, 15))
    _, groups, _ = GridPlaces(config)(observations)
    # Ahead of the centre the modules turn to 45 deg, behind it to 0 deg.
    halves.step(np.full(16, 4 * 1 + 0))
    found = 0
    for i in range(16):
        zone = halves.batch.view(i).zone
        rows, columns = slice(zone[0], zone[0] + zone[1]), slice(zone[2], zone[2] + zone[3])
        group = groups[i].reshape(config.action_kind.shape)
        margin = (len(group) - zone[1]) // 2  # a narrow line has the middle rows
        group = group[margin : margin + zone[1]]
        axes = halves.batch.axes(i)[rows, columns]
        np.testing.assert_allclose(axes[group == 0], 0.25 * np.pi)
        np.testing.assert_allclose(axes[group == 1], 0.0)
        found += int((group >= 0).sum())
    assert found > 16
    halves.close()


def test_actions_are_mirrored_with_the_goal() -> None:
    env = gym.make("SmartSurface/Sort-v0")
    model = PPO(agents.GridPolicy, env, seed=0, device="cpu", n_steps=8, batch_size=8)
    torch.nn.init.normal_(model.policy.mlp_extractor._apart.weight)
    torch.nn.init.normal_(model.policy.mlp_extractor._logits.weight)
    shown = {}
    for side in (1, -1):
        observation, _ = env.reset(seed=3, options={"side": side, "speed": 1.0, "parcel": "S"})
        for _ in range(8):
            shown[side], _ = model.predict(observation, deterministic=True)
            observation, *_ = env.step(shown[side])
    kind = EnvConfig(task="sort").action_kind
    left, right = (shown[side].reshape(kind.shape) for side in (1, -1))
    image = np.array([0, 2, 1, 3])  # of 0, 45, -45, 90 deg
    np.testing.assert_array_equal(image[left[::-1]], right)


def test_it_learns_saves_and_loads(tmp_path) -> None:
    model = PPO(
        agents.GridPolicy, "SmartSurface/Sort-v0", seed=0, device="cpu", n_steps=64, batch_size=32
    )
    before = model.policy.mlp_extractor._apart.weight.clone()
    assert (before == 0.0).all()
    model.learn(128)
    assert not torch.equal(model.policy.mlp_extractor._apart.weight, before)
    model.save(tmp_path / "grid.zip")
    again = PPO.load(tmp_path / "grid.zip", device="cpu")
    observation = model.env.reset()
    np.testing.assert_array_equal(
        again.predict(observation, deterministic=True)[0],
        model.predict(observation, deterministic=True)[0],
    )
    assert isinstance(model.action_space, ModuleChoices)


@pytest.mark.parametrize(
    ("task", "arguments", "message"),
    [
        ("Sort", {"actions": "halves"}, "action_space must be .* got Discrete"),
        ("Sort", {"actions": "window"}, "actions must be 'modules' .* got 'window'"),
        ("Sort", {"orientations": "any"}, "action_space must be .* got Box"),
    ],
)
def test_other_actions_are_refused(task: str, arguments: dict, message: str) -> None:
    env = gym.make(f"SmartSurface/{task}-v0", **arguments)
    with pytest.raises(ValueError, match=message):
        PPO(agents.GridPolicy, env, device="cpu")
