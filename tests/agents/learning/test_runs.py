"""Runs of every algorithm: reproducible, resumed after a break to the same result, refused if the
checkpoint is not theirs; and their learning curve."""

import math
import os
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console
from safetensors.torch import load_file

from surface_gym import agents
from surface_gym.agents.learning import algorithms, config as configs, runs, schedules, slopes
from surface_gym.agents.learning.cuda import train_on_device
from surface_gym.agents.learning.runs import read_curve, train, train_seeds
from surface_gym.agents.learning.shared import SharedLearner
from surface_gym.agents.library import WEIGHTS
from surface_gym.flow.slope_tasks import Merge
from surface_gym.tasks.sort import TERMS
from surface_gym.tasks.stop import TERMS as STOP_TERMS
from tests.agents.rules.runs import gated
from tests.agents.test_policy import Trap

from .envs_on_cpu import envs_on_cpu

SLOPE_TERMS = Merge.terms
_STOP: dict[str, Any] = {
    "task": "stop", "num_envs": 16, "steps": 16_000, "checkpoint_every": 6_000, "hidden": (8,),
}  # fmt: skip
_SORT: dict[str, Any] = {"n_steps": 16, "batch_size": 64, "n_epochs": 2, "hidden": (8, 8)}
_DQN: dict[str, Any] = {
    "buffer_size": 10_000, "learning_starts": 1_000, "gradient_steps": 1, "batch_size": 32,
}  # fmt: skip
_FLOW: dict[str, Any] = {
    "steps": 800, "num_envs": 2, "lines": 1, "batch_size": 4, "gradient_steps": 2,
    "hidden": (8, 8), "checkpoint_every": 250,
}  # fmt: skip
_MERGE: dict[str, Any] = {
    "task": "merge", "steps": 576, "num_envs": 6, "n_steps": 16, "batch_size": 32, "n_epochs": 1,
    "hidden": (8,), "checkpoint_every": 192,
}  # fmt: skip
_CUDA: dict[str, Any] = {
    "device": "cuda", "camera_share": 0.0, "steps": 2048, "checkpoint_every": 1024,
    "num_envs": 16, **_SORT,
}  # fmt: skip
# Each with the control periods after which it is interrupted, and its reward terms.
RUNS: dict[str, tuple[configs.TrainConfig, int, tuple[str, ...]]] = {
    "ppo": (
        algorithms.PPOConfig(**_STOP, n_steps=32, batch_size=256, n_epochs=1), 9_000, STOP_TERMS,
    ),
    "dqn": (algorithms.DQNConfig(**_STOP, **_DQN), 9_000, STOP_TERMS),
    "modules": (
        algorithms.ModulesConfig(
            steps=512, num_envs=8, checkpoint_every=256, camera_share=0.0, **_SORT
        ),
        300, TERMS,
    ),
    "schedule": (algorithms.SchedulesConfig(**_FLOW), 300, schedules.TERMS),
    "parcels": (algorithms.ParcelsConfig(**_MERGE), 300, SLOPE_TERMS),
    "local": (algorithms.LocalConfig(**_MERGE), 300, SLOPE_TERMS),
    "cuda": (algorithms.PPOConfig(**_CUDA, actions="quadrants"), 1_500, TERMS),
}  # fmt: skip
TRAIN = """
import sys
from pathlib import Path
from surface_gym.agents.learning.runs import read_config
from surface_gym.agents.learning.runs import train
folder = Path(sys.argv[1])
train(read_config(folder / "config.yaml"), folder)
"""


def count_as_best(learner: SharedLearner[Any, Any], _: Any) -> None:
    """Rate the last network best, so that each rollout changes what is left."""
    learner._score = float(learner.steps)


@pytest.fixture(autouse=True)
def short_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schedules, "draw_config", lambda *_: gated(queue=2, duration=3.0))
    monkeypatch.setattr(slopes, "DURATION", 0.6)
    monkeypatch.setattr(slopes.StreamLearner, "critic_first", 1)
    monkeypatch.setattr(SharedLearner, "_rate", count_as_best)
    monkeypatch.setattr(slopes, "ROUNDS", ((20, 0.0, 1),))


def run(
    config: configs.TrainConfig, folder: Path, on_progress: Any = lambda *_: None
) -> runs.TrainResult:
    """Train in a folder; a run for a device has environments on the CPU."""
    folder.mkdir(exist_ok=True)
    if configs.device_of(config) != configs.CPU:
        return train_on_device(config, folder, on_progress, envs_on_cpu)
    return train(config, folder, on_progress)


def same(one: Path, other: Path) -> bool:
    first, second = (load_file(each / WEIGHTS) for each in (one, other))
    assert first.keys() == second.keys()
    return all(torch.equal(values, second[name]) for name, values in first.items())


def assert_same(one: Path, other: Path) -> None:
    assert (one / runs.CURVE).read_bytes() == (other / runs.CURVE).read_bytes()
    assert same(one, other)


WHOLE: dict[str, Path] = {}


def whole_run(name: str, factory: pytest.TempPathFactory) -> Path:
    """An unbroken run, in a folder by the name of its entry: trained once."""
    if name not in WHOLE:
        folder = factory.mktemp("whole") / name
        assert not run(RUNS[name][0], folder).interrupted
        WHOLE[name] = folder
    return WHOLE[name]


@pytest.fixture(params=RUNS)
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return whole_run(request.param, tmp_path_factory)


def test_an_interrupted_run_is_resumed_to_the_same_result(whole, tmp_path) -> None:
    config, stop, _ = RUNS[whole.name]
    error = KeyboardInterrupt if whole.name in ("ppo", "modules") else runs.StopTraining

    def interrupt(steps: int, success: float) -> None:
        assert math.isnan(success) or 0.0 <= success <= 1.0
        if steps > stop:
            raise error

    result = run(config, tmp_path, interrupt)
    assert result.interrupted
    assert stop < result.steps < config.steps
    assert not same(whole, tmp_path)
    reported: list[int] = []
    assert not run(config, tmp_path, lambda steps, _: reported.append(steps)).interrupted
    # From the last checkpoint on.
    assert reported[0] > config.checkpoint_every * (stop // config.checkpoint_every)
    assert_same(whole, tmp_path)


def test_its_curve_and_its_policy_are_read(whole) -> None:
    config, _, terms = RUNS[whole.name]
    rows = read_curve(whole)
    rewards = [f"reward_{term}" for term in terms]
    assert set(rows[0]) == {"steps", "success", "return", "length", *rewards}
    total = sum(rows[-1][name] for name in rewards)
    assert rows[-1]["return"] == pytest.approx(total, abs=1e-4) or math.isnan(total)
    assert list((whole / "tensorboard").glob("events*"))
    assert agents.read(whole).card == configs.make_card(config)


@pytest.mark.parametrize("name", RUNS)
def test_a_seed_fixes_the_weights(name, tmp_path) -> None:
    config = replace(RUNS[name][0], steps=1)
    if isinstance(config, algorithms.DQNConfig):
        config = replace(config, steps=160, learning_starts=16)
    for folder, seed in (("one", 3), ("again", 3), ("other", 4)):
        run(replace(config, seed=seed), tmp_path / folder)
    assert same(tmp_path / "one", tmp_path / "again")
    assert not same(tmp_path / "one", tmp_path / "other")


def test_a_killed_run_is_resumed_to_the_same_result(tmp_path, tmp_path_factory) -> None:
    config, broken = RUNS["dqn"][0], tmp_path / "broken"
    broken.mkdir()
    runs.write_config(config, broken / "config.yaml")
    process = subprocess.Popen(
        [sys.executable, "-c", TRAIN, str(broken)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3]), "OMP_NUM_THREADS": "1"},
    )
    while process.poll() is None and not any(row["steps"] > 7_500 for row in read_curve(broken)):
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL  # before it was done
    assert not (broken / WEIGHTS).exists()
    run(config, broken)
    assert_same(whole_run("dqn", tmp_path_factory), broken)


@pytest.mark.parametrize("name", RUNS)
def test_a_damaged_checkpoint_and_a_foreign_one_are_refused(name, tmp_path) -> None:
    config = replace(RUNS[name][0], steps=256)
    run(config, tmp_path)
    with pytest.raises(ValueError, match="damaged or of another run"):
        run(replace(config, hidden=(16,) if name == "parcels" else (8, 9)), tmp_path)
    state = torch.load(tmp_path / runs.CHECKPOINT, weights_only=True)
    counted = state.get("counters", state)
    steps = "num_timesteps" if "counters" in state else "steps"
    for wrong in (-5, 10**30, 1.5, None):
        counted[steps] = wrong
        runs.write_state(state, tmp_path)
        with pytest.raises(ValueError, match=r"checkpoint\.pt .*: \S*steps must be a whole number"):
            run(config, tmp_path)
    counted[steps] = 256
    for recent in (None, [3], [{}], [{"success": "no"}]):
        runs.write_state({**state, "recent": recent}, tmp_path)
        with pytest.raises(
            ValueError, match=r"checkpoint\.pt is damaged .*: (recent|success|\S+) "
        ):
            run(config, tmp_path)


def test_code_in_a_checkpoint_is_not_run(tmp_path) -> None:
    mark = tmp_path / "ran"
    (tmp_path / runs.CHECKPOINT).write_bytes(pickle.dumps(Trap(mark), protocol=2))
    with pytest.raises(ValueError, match="damaged"):
        run(RUNS["ppo"][0], tmp_path)
    assert not mark.exists()


def test_seeds_in_parallel_give_the_result_of_each_alone(tmp_path) -> None:
    config = replace(RUNS["ppo"][0], seed=3, seeds=2, steps=512)
    trained = train_seeds(config, tmp_path, Console(quiet=True), 2)
    assert all(each.steps >= config.steps for each in trained)
    assert [each.name for _, each in runs.seed_folders(config, tmp_path)] == ["seed-3", "seed-4"]
    one, alone = replace(config, seed=4, seeds=1), tmp_path / "alone"
    alone.mkdir()
    assert runs.seed_folders(one, alone) == [(one, alone)]
    train_seeds(one, alone, Console(quiet=True), 2)
    assert same(alone, tmp_path / "seed-4")
    assert not same(alone, tmp_path / "seed-3")


def episode(success: bool, total: float) -> dict[str, Any]:
    terms = {"success": 2.0 * success, "reach": total + 1.0}
    figures = {"r": total, "l": 10, "t": 0.4}
    return {"is_success": success, "episode": figures, "reward_terms": terms}


def test_a_curve_holds_means_of_the_latest_episodes(tmp_path) -> None:
    """A row each; when it goes on from a checkpoint, rows after that are dropped."""
    assert read_curve(tmp_path) == []
    curve = runs.Curve(tmp_path, ("success", "reach"), 0, [])
    assert math.isnan(curve.success)
    curve.add_episodes([{}, episode(True, 2.0), {}, episode(False, 4.0)])
    curve.write(64)
    curve.add_episodes([episode(True, 1.0)] * runs.RECENT_EPISODES)  # more than are averaged
    curve.write(128)
    curve.write(192)
    curve.close()
    first, second, _ = read_curve(tmp_path)
    assert first == {
        "steps": 64, "success": 0.5, "return": 3.0, "length": 10, "reward_success": 1.0,
        "reward_reach": 4.0,
    }  # fmt: skip
    assert second["success"] == second["return"] == 1.0
    with (tmp_path / runs.CURVE).open("a") as file:
        file.write("256,1")  # a line broken off
    assert [row["steps"] for row in read_curve(tmp_path)] == [64, 128, 192]
    again = runs.Curve(tmp_path, ("success", "reach"), 128, list(curve.recent))
    assert [row["steps"] for row in read_curve(tmp_path)] == [64, 128]
    assert again.success == 1.0
    again.close()
