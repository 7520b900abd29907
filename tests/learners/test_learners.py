"""The examples for other libraries, run as a person would, shortly: each is fed what the
environments show and pay, learns, and keeps what docs/learners.md says.
"""

import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

import surface_gym as sg
from surface_gym.registration import PERIODS, env_id

EXAMPLES = Path(__file__).parents[2] / "examples" / "learners"
HYPERPARAMS = EXAMPLES.parents[1] / "agents" / "hyperparams"
DOCS = EXAMPLES.parents[1] / "docs"
PAGE = (DOCS / "learners.md").read_text()
SORT = ("rllib_sort", "cleanrl_sort", "torchrl_sort", "zoo")
PROGRESS = re.compile(r"^ *(\d+) periods: return (\S+), loss (\S+)$", re.MULTILINE)
EVENLY = "0.3 to 2.7 m/s evenly"


def needs(library: str) -> None:
    """Skip where a library is missing; there is Ray without RLlib, too."""
    pytest.importorskip(library, exc_type=ImportError)


@dataclass(frozen=True)
class Run:
    """What an example printed, as it went on, and kept in its file."""

    returns: list[float]
    losses: list[float]
    kept: dict[str, Any]


def run_command(*command: str, folder: Path) -> str:
    """What a command prints."""
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def run(example: str, steps: int, folder: Path) -> Run:
    """Run an example for so many steps; it keeps in the folder what it prints last."""
    file = folder / "kept.yml"
    program = [sys.executable, str(EXAMPLES / f"{example}.py"), "--steps", str(steps)]
    printed = run_command(*program, "--keep", str(file), folder=folder)
    assert printed.endswith(file.read_text())
    found = PROGRESS.findall(printed)
    returns, losses = ([float(each[k]) for each in found] for k in (1, 2))
    return Run(returns, losses, yaml.safe_load(file.read_text()))


@pytest.mark.parametrize(
    ("example", "library", "packages"),
    [
        ("cleanrl_sort", "torch", {"gymnasium", "torch"}),
        ("rllib_sort", "ray.rllib", {"ray"}),
        ("torchrl_sort", "torchrl", {"torchrl", "tensordict"}),
        ("zoo", "rl_zoo3", {"rl_zoo3", "stable_baselines3"}),
    ],
)
def test_it_learns_to_sort(example: str, library: str, packages: set[str], tmp_path: Path) -> None:
    """It gets better, by finite losses, and sorts more than chance does; versions are kept."""
    needs(library)
    done = run(example, 106_496, tmp_path)
    shares = done.kept["figures"][EVENLY]
    assert shares["both"] > 0.4
    assert packages < set(done.kept["versions"])
    if example != "zoo":
        assert all(math.isfinite(loss) for loss in done.losses)
        assert done.returns[-1] > done.returns[0] + 1.0
        assert min(shares["S"], shares["B"]) <= shares["both"] <= max(shares["S"], shares["B"])
        assert done.kept["cores"] == os.cpu_count()


def test_it_learns_of_agents(tmp_path: Path) -> None:
    needs("ray.rllib")
    done = run("rllib_flow", 6_000, tmp_path)
    assert all(math.isfinite(loss) for loss in done.losses)
    assert 0.0 <= done.kept["figures"]["left by their exit"] <= 1.0


@pytest.fixture
def fresh_starts(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(EXAMPLES)
    import fresh_starts

    return fresh_starts


def test_success_is_that_of_single_episodes(fresh_starts: Any) -> None:
    """Axes at -45 deg everywhere sort whoever is to leave to y > 0, if quick enough."""
    num_envs = 40
    shares = fresh_starts.success(lambda seen: np.full(len(seen), 10), num_envs)
    for name, task in fresh_starts.STARTS.items():
        env = sg.SmartSurfaceEnv(task, actions="halves")
        won: dict[str, list[bool]] = {"S": [], "B": []}
        for i in range(num_envs):
            seen, _ = env.reset(seed=1_000_000 + i)
            ended = False
            while not ended:
                _, _, ended, _, info = env.step(10)
            won["S" if seen[fresh_starts.SIZE] < 0.0 else "B"].append(info["is_success"])
        assert 0 < sum(won["S"]) < len(won["S"])
        won["both"] = won["S"] + won["B"]
        expected = {box: pytest.approx(np.mean(each), abs=5e-4) for box, each in won.items()}
        assert shares[name] == expected


def test_speeds_are_even_or_as_they_come(fresh_starts: Any) -> None:
    slow = {}
    for name, task in fresh_starts.STARTS.items():
        _, info = sg.SmartSurfaceVectorEnv(2000, task, actions="halves").reset(seed=0)
        slow[name] = float((info["velocity"][:, 0] < 1.1).mean())
    assert slow["as they come"] == pytest.approx(0.5 + 0.5 / 3, abs=0.03)
    assert slow[EVENLY] == pytest.approx(1 / 3, abs=0.03)


def test_torchrls_rollout_is_that_of_single_environments() -> None:
    needs("torchrl")
    from torchrl.envs import GymWrapper

    mode = AutoresetMode.DISABLED
    envs = gym.make_vec("SmartSurface/Sort-v0", 4, actions="halves", autoreset_mode=mode)
    env = GymWrapper(envs, categorical_action_encoding=True)
    env.set_seed(0)
    rollout = env.rollout(150, break_when_any_done=False)
    assert int(rollout["next", "done"].sum()) > 8
    for i, way in enumerate(rollout):
        single = sg.SmartSurfaceEnv("sort", actions="halves")
        single.reset(seed=i)  # set_seed resets too
        seen, _ = single.reset()
        for step in way:
            assert step["observation"].tolist() == seen.tolist()
            seen, reward, terminated, *_ = single.step(int(step["action"]))
            assert step["next", "observation"].tolist() == seen.tolist()
            assert step["next", "reward"].item() == pytest.approx(reward)
            assert bool(step["next", "terminated"]) == terminated
            if bool(step["next", "done"]):
                seen, _ = single.reset()


def test_rllibs_environments_are_those_of_the_native_vector_env() -> None:
    """Each episode that is learned from is one of a single environment."""
    needs("ray.rllib")
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

    config = PPOConfig().environment("SmartSurface/Sort-v0", env_config={"actions": "halves"})
    config.env_runners(num_envs_per_env_runner=4, gym_env_vectorize_mode="vector_entry_point")
    runner = SingleAgentEnvRunner(config=config.debugging(seed=0))
    assert isinstance(runner.env.unwrapped, sg.SmartSurfaceVectorEnv)
    sampled = runner.sample(num_episodes=4, random_actions=True)
    singles = [sg.SmartSurfaceEnv("sort", actions="halves") for _ in range(4)]
    starts = {single.reset(seed=k)[0].tobytes(): single for k, single in enumerate(singles)}
    for episode in sampled:
        seen = episode.get_observations()
        single = starts.pop(seen[0].tobytes())  # any other start would be a KeyError
        steps = zip(episode.get_actions(), episode.get_rewards(), seen[1:], strict=True)
        for action, reward, after in steps:
            expected, paid, terminated, *_ = single.step(action)
            assert (after.tolist(), reward) == (expected.tolist(), pytest.approx(paid))
        assert episode.is_terminated == terminated
    runner.stop()


def test_agents_of_a_flow_live_in_one_stretch_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """They see and are paid what the flow says, and 1 less for a jam."""
    needs("ray.rllib")
    monkeypatch.syspath_prepend(EXAMPLES)
    import rllib_flow

    env, flow = rllib_flow.FlowOfAgents({}), rllib_flow.flow()
    random = np.random.default_rng(0)
    outcomes = set()
    for seed in range(6):
        seen, _ = env.reset(seed=seed)
        expected, _ = flow.reset(seed=seed)
        gone: set[str] = set()
        while flow.agents:
            assert set(seen) == set(flow.agents)
            assert not set(seen) & gone
            actions = {a: random.integers(4, size=2) if seed % 2 else (2, 2) for a in flow.agents}
            expected, paid, *ends, _ = flow.step(actions)
            seen, rewards, terminated, truncated, done = env.step(actions)
            stretch_ends = not set(actions) & set(flow.agents)
            assert terminated.pop("__all__") == stretch_ends
            assert not truncated.pop("__all__")
            assert [terminated, truncated] == [{a: end[a] for a in seen} for end in ends]
            assert set(seen) == (set(actions) if stretch_ends else set(expected))
            for agent, info in done.items():
                outcomes.add(info.get("outcome"))
                jammed = info.get("outcome") == "jam"
                assert rewards[agent] == pytest.approx(paid[agent] - jammed)
            gone |= set(actions) - set(flow.agents)
            if stretch_ends:
                seen, _ = env.reset()
            if not flow.agents:
                break
            seen = {agent: seen[agent] for agent in flow.agents}
            assert all(seen[a].tolist() == expected[a].tolist() for a in seen)
    assert {"jam", "correct"} <= outcomes


@pytest.mark.parametrize("algo", ["ppo", "dqn"])
def test_the_zoos_command_takes_the_yaml(algo: str, tmp_path: Path) -> None:
    needs("rl_zoo3")
    file = HYPERPARAMS / f"{algo}.yml"
    run_command(
        sys.executable, "-m", "rl_zoo3.train", "--algo", algo, "--env", "SmartSurface/Sort-v0",
        "--gym-packages", "surface_gym", "--conf-file", str(file), "--n-timesteps", "100",
        "--eval-freq", "-1", "--log-folder", str(tmp_path), folder=tmp_path,
    )  # fmt: skip
    folder = tmp_path / algo / "SmartSurface-Sort-v0_1"
    assert (folder / "SmartSurface-Sort-v0.zip").is_file()
    used = yaml.unsafe_load((folder / "SmartSurface-Sort-v0" / "config.yml").read_text())
    assert dict(used) == yaml.safe_load(file.read_text())["SmartSurface/Sort-v0"]


def by_gymnasium(env_id: str) -> Any:
    envs = AsyncVectorEnv([partial(gym.make, env_id)] * 2, context="spawn")
    envs.reset(seed=0)
    infos = envs.step(envs.action_space.sample())[4]
    envs.close()
    return {**infos, "outcome": np.stack(infos["outcome"])}


def by_torchrl(env_id: str) -> Any:
    from torchrl.envs import GymEnv

    env = GymEnv(env_id, num_envs=2)
    env.set_seed(0)
    rollout = env.rollout(3, break_when_any_done=False)["next"]
    env.close()
    return {name: value.numpy() for name, value in rollout.items()}


def by_minari(env_id: str) -> Any:
    needs("jax")  # with which it collects steps
    from minari import DataCollector

    env = DataCollector(gym.make(env_id), record_infos=True)
    env.reset(seed=0)
    while not any(env.step(env.action_space.sample())[2:4]):
        pass
    (episode,) = env.create_dataset("sort-v0").iterate_episodes()
    env._tmp_dir.cleanup()
    return episode.infos


def by_rllib(env_id: str) -> Any:
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.connectors.env_to_module import FlattenObservations
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

    config = PPOConfig().environment(env_id)
    config.env_runners(
        num_envs_per_env_runner=2,
        gym_env_vectorize_mode="sync",
        env_to_module_connector=lambda *_, **__: FlattenObservations(),
    )
    runner = SingleAgentEnvRunner(config=config)
    infos = runner.sample(num_timesteps=6, random_actions=True)[0].get_infos()
    runner.stop()
    return {name: np.stack([info[name] for info in infos]) for name in infos[-1]}


# Minari asks for an author, and leaves folders to be cleaned up.
@pytest.mark.filterwarnings("ignore:.* is set to None", "ignore:Implicitly cleaning")
@pytest.mark.parametrize("env_id", [env_id(name) for name in PERIODS])
@pytest.mark.parametrize(
    ("library", "way"),
    [
        ("gymnasium", by_gymnasium), ("torchrl", by_torchrl), ("minari", by_minari),
        ("ray.rllib", by_rllib),
    ],
)  # fmt: skip
def test_a_library_stacks_infos_in_its_own_way(
    library: str, way: Callable[[str], Any], env_id: str, tmp_path: Path, monkeypatch: Any
) -> None:
    needs(library)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    _, single = gym.make(env_id).reset(seed=0)
    stacked = way(f"surface_gym:{env_id}")
    for name, value in single.items():
        array = np.asarray(stacked[name])
        assert array.dtype.kind in "bif", name
        assert len(array) > 1
        assert array.shape[array.ndim - np.ndim(value) :] == np.shape(value), name


@pytest.mark.parametrize("example", [*SORT, "rllib_flow"])
def test_the_page_says_what_was_kept(example: str) -> None:
    """Versions are those of its requirements too, where the example has some of its own."""
    kept = yaml.safe_load((DOCS / "learners" / f"{example}.yml").read_text())
    figures, seconds, versions = kept["figures"], kept["seconds"], kept["versions"]
    if example in SORT:
        shares = [
            " / ".join(f"{figures[starts][box]:.3f}" for box in ("S", "B", "both"))
            for starts in figures
        ]
        assert f"| {seconds} | {' | '.join(shares)} |" in PAGE
    else:
        assert f"{figures['left by their exit']:.3f} of the parcels" in PAGE.replace("\n", " ")
        assert f"{seconds} s" in PAGE
    file = EXAMPLES / f"{example.split('_')[0]}.txt"
    lines = file.read_text().splitlines() if file.is_file() else []
    asked = dict(
        line.replace("[rllib]", "").split("==") for line in lines if not line.startswith("#")
    )
    for name in versions.keys() - {"python", "surface_gym"}:
        version = versions[name].split("+")[0]  # without the build
        assert asked.get(name, version) == version
        assert version in PAGE


def test_pixels_are_learned_from(tmp_path: Path) -> None:
    """Versions are kept; few control periods sort less than the fixed layout, which sorts 0.769."""
    needs("stable_baselines3")
    done = run("pixels", 8192, tmp_path)
    assert {"torch", "stable_baselines3"} < set(done.kept["versions"])
    assert 0.0 <= done.kept["figures"]["success"] < 0.769


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.py")), ids=lambda file: file.stem)
def test_an_example_is_short(file: Any) -> None:
    assert len(file.read_text().splitlines()) <= 80
