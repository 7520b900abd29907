"""What is asked for on a device: its own defaults; what cannot be is refused by name."""

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import pytest
import yaml

from agents.learning.card import command_of
from agents.learning.command import open_run
from agents.learning.config import ModulesConfig, PPOConfig
from agents.learning.device import lanes
from agents.learning.hyperparams import (
    FOLDER,
    defaults,
    read_config,
    write_config,
    write_hyperparams,
)
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS

ROOT = Path(__file__).parents[4]
NO_GPU = "cuda must be there, got none"


@pytest.fixture
def no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lanes that say that there is none."""

    def refuse(*_: object, **__: object) -> None:
        raise RuntimeError(NO_GPU)

    monkeypatch.setattr(lanes.gym, "make_vec", refuse)


@pytest.fixture
def a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lanes that can be made; nothing is asked of them here."""

    class Made:
        def close(self) -> None:
            pass

    monkeypatch.setattr(lanes.gym, "make_vec", lambda *_, **__: Made())


@pytest.mark.parametrize("task", [*TASKS, f"{ROOT}/examples/reach.py:Reach"])
def test_every_task_has_defaults_for_a_device(task: str, tmp_path: Path) -> None:
    config = defaults(task, "ppo", device="cuda")
    assert isinstance(config, PPOConfig)
    assert (config.task, config.device, config.camera_share) == (task, "cuda", 0.0)
    assert config.lanes >= 16_384
    assert config.checkpoint_every >= 10 * config.lanes * config.n_steps  # legs of many rollouts
    write_hyperparams(config, tmp_path / "own.yml")
    assert defaults(task, "ppo", tmp_path / "own.yml", device="cuda") == config


def test_the_file_is_in_the_zoos_schema() -> None:
    entries = yaml.safe_load((FOLDER / "ppo-cuda.yml").read_text())
    of_cpu = yaml.safe_load((FOLDER / "ppo.yml").read_text())
    assert set(entries) == {*of_cpu, "beside the zoo"}
    assert set(entries[env_id("sort")]) == set(of_cpu[env_id("sort")])


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--algo", "dqn"], "algo, on device 'cuda', must be one of 'ppo', got 'dqn'"),
        (["--algo", "modules"], "algo, on device 'cuda', must be one of 'ppo', got 'modules'"),
        (["--task", "flow"], "algo, on device 'cuda', must be one of 'ppo', got 'parcels'"),
        (["--camera-share", "0.5"], "camera_share must be 0.0 for device 'cuda', got 0.5"),
        (["--zones", "8"], "zones must be () for device 'cuda', got (8,)"),
        (["--condition", "lab"], "condition must be 'nominal' for device 'cuda', got 'lab'"),
        ([], NO_GPU),
    ],
)
@pytest.mark.usefixtures("no_gpu")
def test_refusals_name_what_is_wrong_and_leave_no_folder(
    arguments: list[str],
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, SystemExit)) as raised:
        open_run(["--device", "cuda", *arguments])
    told = str(raised.value) + capsys.readouterr().err
    assert " ".join(named.split()) in " ".join(told.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


def test_an_unknown_device_is_refused() -> None:
    with pytest.raises(ValueError, match="device must be one of 'cpu', 'cuda', got 'tpu'"):
        PPOConfig(device="tpu")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="algo must be 'ppo' for device 'cuda', got 'modules'"):
        ModulesConfig(device="cuda", camera_share=0.0)


@pytest.mark.usefixtures("a_gpu")
def test_a_run_is_opened_again_and_its_command_names_the_device(tmp_path: Path) -> None:
    flags = ["--device", "cuda", "--lanes", "32768", "--out", str(tmp_path), "--name", "a"]
    config, folder = open_run(flags)
    assert isinstance(config, PPOConfig)
    assert config == replace(
        defaults("sort", "ppo", device="cuda"), lanes=32768, out=tmp_path, name="a"
    )
    assert open_run(["--resume", str(folder)]) == (config, folder)
    assert command_of(config).endswith("--task sort --algo ppo --device cuda --lanes 32768")


def test_a_run_from_before_there_were_devices_learns_on_the_cpu(tmp_path: Path) -> None:
    write_config(PPOConfig(), tmp_path / "config.yaml")
    plain = yaml.safe_load((tmp_path / "config.yaml").read_text())
    del plain["device"]
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(plain))
    assert read_config(tmp_path / "config.yaml") == PPOConfig()


def test_lanes_are_asked_for_with_what_the_run_says(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, object] = {}

    def take(name: str, **arguments: object) -> None:
        asked.update(arguments, name=name)

    monkeypatch.setattr(gym, "make_vec", take)
    config = defaults("slow", "ppo", device="cuda")
    assert isinstance(config, PPOConfig)
    lanes.make_lanes(replace(config, control_period=0.02, observe=("load",)), 7)
    task = TASKS["slow"]()
    assert asked == {
        "name": "SmartSurface/Slow-v0", "num_envs": 7, "device": "cuda", "task": task,
        "max_episode_steps": task.periods, "actions": "halves", "control_period": 0.02,
        "observe": ("load",), "autoreset_mode": "SameStep",
    }  # fmt: skip
