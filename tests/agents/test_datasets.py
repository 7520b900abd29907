"""Data sets of episodes: those of single environments, whole or not at all."""

import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from surface_gym import cli
from surface_gym.agents import datasets, library
from surface_gym.agents.benchmark.entry import SEED as TEST_SEED
from surface_gym.agents.dataset_cli import MAX_EPISODES, MAX_SEED, DatasetConfig, main
from surface_gym.agents.datasets import (
    MIXED_RATES,
    RECIPES,
    REFERENCE_SEED,
    EpisodesJob,
    compute_score,
    find_recipe,
    write_dataset,
)
from surface_gym.agents.library import SHELF
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.rules import BEST_RULES
from surface_gym.config import EnvConfig
from surface_gym.registration import PERIODS, SHIPPED, env_id

ROOT = Path(__file__).parents[2]
NAME = "own/sort/rule-v0"


def play_alone(recipe: Any, seed: int) -> tuple[Any, Any, Any, Any]:
    """Observations, actions, rewards and the last info of an episode in a single environment."""
    env = gym.make(env_id(recipe.task), **recipe.arguments)
    controller = recipe.method.controller(env.unwrapped.config, recipe.method.seeds[0])
    observation, _ = env.reset(seed=seed)
    observations, actions, rewards, state, over = [observation], [], [], None, False
    while not over:
        begun = np.array([not actions])
        action, state = controller.predict(observation[np.newaxis], state, begun)
        observation, reward, terminated, truncated, info = env.step(action[0])
        observations.append(observation)
        actions.append(action[0])
        rewards.append(reward)
        over = terminated or truncated
    return np.array(observations), np.array(actions), np.array(rewards), info


@pytest.mark.parametrize("policy", ["rule", "agent", "lab"])
def test_episodes_are_a_single_environments(policy: str) -> None:
    recipe = find_recipe("sort", policy)
    found = EpisodesJob(recipe, 70, 7, 3)()
    assert [each.seed for each in found] == list(range(70, 77))
    for each in found:
        observations, actions, rewards, info = play_alone(recipe, each.seed)
        np.testing.assert_array_equal(each.observations, observations)
        np.testing.assert_array_equal(each.actions, actions)
        np.testing.assert_array_equal(each.rewards, rewards)
        assert each.success == info["is_success"]
        assert each.is_terminated == (info["outcome"] not in ("running", "out of time"))


def test_results_are_those_of_rollouts() -> None:
    """The same starts as in an evaluation; some succeed, and some do not."""
    recipe = find_recipe("sort", "rule")
    found = EpisodesJob(recipe, 0, 60, 17)()
    config = EnvConfig("sort", **recipe.arguments)
    rule = recipe.method.controller(config, 0)
    episodes = run_episodes(rule, config, [{}] * 60, seed=0)
    np.testing.assert_array_equal([each.success for each in found], episodes.success)
    periods = np.ceil(episodes.time / config.control_period - 1e-9)
    np.testing.assert_array_equal([len(each.rewards) for each in found], periods)
    score = compute_score([each.result for each in found])
    assert score.success == round(float(episodes.success.mean()), 4)
    assert 0.0 < score.success < 1.0


@pytest.mark.parametrize("policy", ["mixed", "random"])
def test_episodes_do_not_depend_on_how_many_are_played_at_once(policy: str) -> None:
    recipe = find_recipe("sort", policy)
    together = EpisodesJob(recipe, 5, 12, 12)()
    apart = [*EpisodesJob(recipe, 5, 4, 3)(), *EpisodesJob(recipe, 9, 8, 1)()]
    for one, other in zip(together, apart, strict=True):
        assert (one.seed, one.success) == (other.seed, other.success)
        np.testing.assert_array_equal(one.observations, other.observations)
        np.testing.assert_array_equal(one.actions, other.actions)


def test_random_actions_come_at_their_rates() -> None:
    recipe = find_recipe("sort", "mixed")
    controller = recipe.method.controller(EnvConfig("sort", **recipe.arguments), 0)
    shares = np.zeros((2, len(MIXED_RATES)))
    for each in EpisodesJob(recipe, 0, 240, 60)():
        decided, _ = controller.predict(each.observations[:-1])
        shares[:, each.seed % len(MIXED_RATES)] += (each.actions != decided).sum(), len(decided)
    differ, all_periods = shares
    # A random action of 16 is the agent's own once in 16 times.
    expected = np.array(MIXED_RATES) * 15.0 / 16.0
    np.testing.assert_allclose(differ / all_periods, expected, atol=0.03)
    assert differ[0] == 0


def test_streams_are_cut_into_episodes() -> None:
    recipe = find_recipe("flow", "roll on")
    short = replace(recipe, method=replace(recipe.method, arguments={
        **recipe.method.arguments, "duration": 2.0, "max_parcels": 6,
    }))  # fmt: skip
    found = EpisodesJob(short, 3, 3, 2)()
    for each in found:
        assert each.observations.shape[:2] == (51, 6)
        assert len(each.actions) == len(each.rewards) == 50
        env = gym.make(env_id("flow"), **short.arguments)
        observation, _ = env.reset(seed=each.seed)
        np.testing.assert_array_equal(each.observations[0], observation)
        for k, action in enumerate(each.actions):
            observation, *_, info = env.step(action)
            np.testing.assert_array_equal(each.observations[k + 1], observation)
        assert each.success == info["correct"]


@pytest.mark.parametrize("task", SHIPPED)
def test_every_task_has_its_recipes(task: str) -> None:
    """Random actions, a rule and, except for streams, a planner; of shipped agents where one is."""
    has_agents = any(name.startswith(f"{task}-") for name in library.names())
    for policy in RECIPES:
        try:
            recipe = find_recipe(task, policy)
        except ValueError:
            if policy == "planner":
                assert PERIODS[task] is None
            else:
                assert policy in ("agent", "mixed", "lab")
                assert not has_agents or task == "flow"
            continue
        assert recipe.task == task
        assert (recipe.preset == "lab") == (policy == "lab")
    assert find_recipe(task, "rule", "lab").preset == "lab"


def test_best_rules_are_those_of_the_benchmark() -> None:
    spec = importlib.util.spec_from_file_location("entry", ROOT / "examples/entries/rules.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert BEST_RULES == module.RULE


def test_seeds_are_not_the_benchmarks() -> None:
    assert MAX_SEED + MAX_EPISODES < REFERENCE_SEED < TEST_SEED


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An own folder of data sets; reference scores of few episodes."""
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    monkeypatch.setattr(datasets, "PARCELS", datasets.Portion(4, 4, 8))
    return tmp_path


@pytest.mark.usefixtures("root")
class TestDataset:
    def test_minari_reads_it_and_recovers_its_environment(self) -> None:
        import minari

        score = write_dataset(NAME, find_recipe("sort", "rule"), 40, 10)
        dataset = minari.load_dataset(NAME)
        assert len(dataset) == dataset.total_episodes == score.episodes == 10
        assert list(minari.list_local_datasets()) == [NAME]
        env = dataset.recover_environment()
        assert dataset.observation_space == env.observation_space
        assert dataset.action_space == env.action_space
        marks = list(dataset.storage.get_episode_metadata(range(10)))
        assert [each["seed"] for each in marks] == list(range(40, 50))
        steps = 0
        for episode, mark in zip(dataset, marks, strict=True):
            observation, _ = env.reset(seed=mark["seed"])
            observations, over = [observation], False
            for k, action in enumerate(episode.actions):
                observation, reward, terminated, truncated, info = env.step(action)
                observations.append(observation)
                assert reward == episode.rewards[k]
                assert terminated == episode.terminations[k]
                over = over or terminated or truncated
                assert over == (k == len(episode) - 1)
            np.testing.assert_array_equal(episode.observations, observations)
            assert episode.truncations[-1] == (not terminated)
            assert all(dataset.observation_space.contains(each) for each in observations)
            assert mark["success"] == info["is_success"]
            steps += len(episode)
        assert dataset.total_steps == steps

    def test_its_scores_stand_beside_it(self) -> None:
        import minari

        recipe = find_recipe("sort", "rule")
        score = write_dataset(NAME, recipe, 0, 6)
        dataset = minari.load_dataset(NAME)
        found = dataset.storage.metadata
        returns = np.array([each.rewards.sum() for each in dataset])
        assert found["score"]["mean_return"] == score.mean_return == round(returns.mean(), 4)
        scores = found["reference_scores"]
        assert list(scores) == ["random", "fixed layout", "rule", "agent"]
        played = EpisodesJob(recipe, REFERENCE_SEED, 8, 8)()
        assert (
            scores["rule"]["mean_return"]
            == compute_score([each.result for each in played]).mean_return
        )
        means = {name: each["mean_return"] for name, each in scores.items()}
        assert found["best_known"] == max(means, key=means.__getitem__)
        low, high = means["random"], max(means.values())
        np.testing.assert_allclose(
            minari.get_normalized_score(dataset, returns), (returns - low) / (high - low)
        )

    def test_an_error_leaves_nothing_under_its_name(self, root: Path, monkeypatch) -> None:
        def fail(*_: Any) -> None:
            raise RuntimeError("full disk")

        recipe = find_recipe("sort", "rule")
        with monkeypatch.context() as patched:
            patched.setattr(datasets, "_describe", fail)
            with pytest.raises(RuntimeError, match="full disk"):
                write_dataset(NAME, recipe, 0, 6)
        assert not list(root.iterdir())
        write_dataset(NAME, recipe, 0, 6)
        with pytest.raises(ValueError, match=f"name must be new, got '{NAME}': delete it by"):
            write_dataset(NAME, recipe, 0, 6)


def test_ctrl_c_leaves_no_data_set(root: Path) -> None:
    command = [sys.executable, "-c", "from surface_gym.cli import main; main()", "dataset", "sort"]
    # A shell's background ignores Ctrl-C, and its processes with it.
    with subprocess.Popen(
        [*command, "--episodes", "1000000", "--workers", "1"], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline().startswith("dataset: 0/")
        while "random" not in process.stdout.readline():
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == "interrupted: no data set was written; the same command begins again\n"
    assert not list(root.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fly"], "task must be one of 'sort', .* got 'fly'"),
        (["sort", "--policy", "nobody"], "policy must be one of .*'event rule'.* got 'nobody'"),
        (["sort", "--policy", "slow-ppo"], "task must be one of 'slow', got 'sort'"),
        (["flow", "--policy", "planner"], "policy must be one of .* got 'planner'"),
        (["sort", "--preset", "home"], "preset must be one of .*'lab', got 'home'"),
        (["sort", "--episodes", "0"], "episodes must be a whole number of at least 1, got 0"),
        (["sort", "--seed", "-1"], "seed must be a whole number of at least 0, got -1"),
        (["sort", "--name", "a b"], "name must be like smart-surface/sort/rule-v0, got 'a b'"),
        (["sort", "--name", "../x-v0"], r"name must be like .*, got '\.\./x-v0'"),
    ],
)
def test_bad_input_is_named_in_one_line(
    arguments: list[str], message: str, root: Path, capsys: Any
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    printed = f"{caught.value} {capsys.readouterr().err}"
    assert re.search(message, " ".join(printed.split()))
    assert not list(root.iterdir())


def test_a_missing_library_is_named(monkeypatch: Any, root: Path) -> None:
    monkeypatch.setitem(sys.modules, "minari.dataset.minari_storage", None)
    with pytest.raises(SystemExit, match=r"needs minari, .* pip install .*agents,data"):
        cli.main(["dataset", "sort", "--episodes", "1"])
    assert not list(root.iterdir())


def test_the_policy_of_a_run_acts(tmp_path: Path) -> None:
    folder = shutil.copytree(SHELF / "sort-ppo" / "seed-0", tmp_path / "run")
    recipes = [find_recipe("sort", name) for name in (str(folder), "sort-ppo", "agent")]
    found = [EpisodesJob(each, 0, 2, 2)() for each in recipes]
    for first, *others in zip(*found, strict=True):
        for other in others:
            np.testing.assert_array_equal(first.actions, other.actions)
    with pytest.raises(ValueError, match="task must be one of 'sort', got 'slow'"):
        find_recipe("slow", str(folder))


def test_names_follow_task_policy_and_preset() -> None:
    assert DatasetConfig("sort", "event rule").title == "smart-surface/sort/event-rule-v0"
    assert (
        DatasetConfig("sort", "PPO, lab", preset="lab").title == "smart-surface/sort/ppo-lab-lab-v0"
    )
    assert DatasetConfig("sort", name="me/mine-v3").title == "me/mine-v3"
