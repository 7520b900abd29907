"""The shipped agents: each loads, acts and succeeds as its card says."""

import sys

import gymnasium as gym
import numpy as np
import pytest
import yaml

from surface_gym import agents
from surface_gym.agents.library import CARD, SHELF, read
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.scheduling import scheduler
from surface_gym.tasks import TASKS
from tests.environments import ON_SLOPES as SLOPES

FLOW = "flow-schedule"
OF_MODULES = {"singulate-local", "merge-local"}
ON_SLOPES = {f"{task}-parcels" for task in SLOPES} | OF_MODULES
TRAINED = [task for task in TASKS if task != "park"]  # no agent is shipped for Park
FOR_THE_LAB = {"sort-dqn-lab", *(f"{task}-ppo-lab" for task in TRAINED)}


def test_a_ppo_and_a_dqn_for_each_task_and_one_each_for_modules_and_streams() -> None:
    of_tasks = {f"{task}-{algo}" for task in TRAINED for algo in ("ppo", "dqn")}
    wanted = of_tasks | FOR_THE_LAB | {"sort-modules", FLOW} | ON_SLOPES
    assert set(agents.names()) == wanted


@pytest.mark.parametrize("name", agents.names())
class TestEach:
    def test_it_acts_in_its_environment_and_seeds_differ(self, name, request, monkeypatch) -> None:
        if name == FLOW:  # tries its maneuvers on a surface
            monkeypatch.setattr(scheduler, "TRIAL", 2.0)
        else:
            request.getfixturevalue("uncompiled")
        policy, other = (agents.load(name, seed) for seed in agents.seeds(name)[:2])
        env = gym.make(policy.env_id, **policy.env_kwargs)
        observation, _ = env.reset(seed=0)
        action, _ = policy.predict(observation, deterministic=True)
        assert action in env.action_space
        envs = gym.make_vec(policy.env_id, num_envs=3, **policy.env_kwargs)
        observations, _ = envs.reset(seed=0)
        assert policy.predict(observations)[0] in envs.action_space
        if name == FLOW or name in ON_SLOPES:  # first decisions are the same
            cards = [SHELF / name / f"seed-{seed}" / CARD for seed in agents.seeds(name)]
            digests = {yaml.safe_load(card.read_text())["digest"] for card in cards}
            assert len(digests) == len(cards)
            return
        shape = (256, *observation.shape)
        random = np.random.default_rng(0).normal(size=shape).astype(np.float32)
        assert (policy.predict(random)[0] != other.predict(random)[0]).any()

    def test_its_card_says_how_it_came_about(self, name) -> None:
        card = yaml.safe_load((SHELF / name / "card.yaml").read_text())
        assert card["command"].startswith("python ")
        assert card["seeds"] == list(agents.seeds(name))
        assert len(card["steps"]) == len(card["seconds"]) == len(card["seeds"]) >= 3
        for preset in ("exact", "camera", "lab") if name in FOR_THE_LAB else ("exact", "camera"):
            results = card["results"][preset]
            if name in ON_SLOPES:
                for scenario in results.values():
                    assert len(scenario["right_an_hour_of_each_seed"]) == len(card["seeds"])
                    assert 0.0 < scenario["share_right"] <= 1.0
                continue
            if name == FLOW:
                for stream in results.values():
                    assert len(stream["capacity_of_each_seed"]) == len(card["seeds"])
                    assert min(stream["capacity_of_each_seed"]) > 0
                continue
            assert results["interval"][0] <= results["success"] <= results["interval"][1]
            mean = np.mean(results["success_of_each_seed"])
            assert mean == pytest.approx(results["success"], abs=1e-3)
        assert sum(file.stat().st_size for file in (SHELF / name).rglob("*")) < 640_000


def test_unknown_names_and_seeds_are_refused(tmp_path) -> None:
    with pytest.raises(ValueError, match="name must be one of"):
        agents.load("juggle-ppo")
    with pytest.raises(ValueError, match="seed must be one of"):
        agents.load("sort-ppo", seed=99)
    with pytest.raises(ValueError, match="folder must be a path, got 5"):
        read(5)
    with pytest.raises(ValueError, match="holds no policy"):
        read(tmp_path)
    (tmp_path / "policy.yaml").write_text("algo: modules\n")
    with pytest.raises(ValueError, match=r"policy\.safetensors is missing"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("name", "start"),
    [("sort-ppo", {"speed": 0.6}), ("stop-ppo", {}), ("track-ppo", {"tilt": 0.21})],
)
def test_a_few_starts_go_as_the_card_says(name, start) -> None:
    policy = agents.load(name)
    config, starts = policy.card.env_config(), [{"parcel": "S", **start}] * 3
    assert run_episodes(policy, config, starts, seed=0).success.all()


def test_a_missing_library_is_reported_with_its_extra(monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "surface_gym.agents.policy", raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ImportError, match=r"needs torch, .*'surface_gym\[agents\]'"):
        agents.load("sort-ppo")
