"""The command line of train.py: defaults of the task, resumed runs, searches, refusals."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from surface_gym.agents import train_cli
from surface_gym.agents.learning import algorithms, config as configs, runs
from surface_gym.agents.learning.cuda import gym as gym_of_device
from surface_gym.agents.train_cli import SWEEP, Request, parse_arguments
from surface_gym.machine.estimate import Estimate
from tests.machine.recorded import ESTIMATE

NO_GPU = "cuda must be there, got none"


def config_of(*arguments: str) -> configs.TrainConfig:
    config = parse_arguments(arguments).config
    assert config is not None
    return config


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")


def test_a_new_run_has_a_new_folder_which_is_resumed_as_it_was_asked_for(tmp_path) -> None:
    arguments = ["--task", "slow", "--num-envs", "64", "--out", str(tmp_path)]
    config = config_of(*arguments)
    folder = runs.make_folder(config, arguments)
    assert folder.parent == tmp_path
    assert folder.name.startswith("slow-ppo-seed0-")
    assert (folder / "command.txt").read_text().startswith("python train.py --task slow")
    resumed = parse_arguments(["--resume", str(folder)])
    assert resumed == Request(None, None, config=config, folder=folder)
    named = replace(config, name="a")
    runs.make_folder(named, arguments)
    with pytest.raises(ValueError, match="--resume"):
        runs.make_folder(named, arguments)


def test_a_run_keeps_the_estimate_of_its_surface(tmp_path) -> None:
    ESTIMATE.save(tmp_path / "found.json")
    arguments = ["--task", "stop", "--estimate", str(tmp_path / "found.json"), "--out", "."]
    config = config_of(*arguments)
    folder = runs.make_folder(config, arguments)
    (tmp_path / "found.json").unlink()
    resumed = parse_arguments(["--resume", str(folder)]).config
    assert resumed == replace(config, estimate=folder / runs.ESTIMATE)
    assert Estimate.load(resumed.estimate) == ESTIMATE
    assert f"--estimate {resumed.estimate}" in runs.training_command(resumed)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("--steps 0", "steps"), ("--gamma 2", "gamma"), ("--task juggle", "juggle"),
        ("--algo sac", "sac"), ("--hidden x", "hidden"), ("--algo dqn --actions window", "actions"),
        ("--algo modules --task slow", "task must be one of 'sort'"),
        ("--estimate nowhere.json", "estimate must be a file of identify, got nowhere.json"),
        ("--resume nowhere", "nowhere"),
        ("--resume nowhere --steps 5", "--resume must stand alone"),
        ("--resume there --steps 5", "--resume must stand alone"),
        ("--search wide.yml --steps 5", "--search must stand alone"),
        ("--search wide.yml --resume there", "--search must stand alone"),
        ("--search wide.yml --out . --name there", "--resume there goes on"),
        ("--device cuda --algo dqn", "algo must be one for device 'cuda', got 'dqn'"),
        ("--device cuda --task flow", "algo must be one for device 'cuda'"),
        ("--device cuda --camera-share 0.5", "camera_share must be 0.0 for device 'cuda', got 0.5"),
        ("--device cuda --zones 8", "zones must be () for device 'cuda', got (8,)"),
        ("--device cuda --preset lab", "preset must be 'nominal' for device 'cuda', got 'lab'"),
        ("--device tpu", "tpu"), ("--device cuda", NO_GPU),
    ],
)  # fmt: skip
def test_refusals_name_what_is_wrong_and_leave_no_folder(
    arguments, named, monkeypatch, capsys
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise RuntimeError(NO_GPU)

    monkeypatch.setattr(gym_of_device, "make_vec", refuse)
    Path("there").mkdir()
    Path("there", SWEEP).touch()
    with pytest.raises(SystemExit) as raised:
        train_cli.main(arguments.split())
    message = str(raised.value) + capsys.readouterr().err
    assert " ".join(named.split()) in " ".join(message.replace("│", " ").split())
    assert [file.name for file in Path().iterdir()] == ["there"]


def test_defaults_are_those_of_task_and_algorithm(tmp_path) -> None:
    config = config_of("--task", "track", "--algo", "dqn", "--seed", "3", "--out", str(tmp_path))
    assert isinstance(config, algorithms.DQNConfig)
    assert config == replace(configs.defaults("track", "dqn"), seed=3, out=tmp_path)
    assert config_of("--algo", "modules") == configs.defaults("sort", "modules")
    assert config_of("--task", "flow") == configs.defaults("flow", "schedule")
    assert config_of("--task", "merge") == configs.defaults("merge", "parcels")
    lab = config_of("--task=slow", "--preset=lab", "--hidden", "8", "9")
    assert lab == replace(configs.defaults("slow", "ppo", preset="lab"), hidden=(8, 9))
    # A user's file gives other defaults.
    own = replace(configs.defaults("slow", "ppo"), gamma=0.9)
    configs.write_hyperparams(own, tmp_path / "own.yml")
    flags = ["--task", "slow", "--hyperparams", str(tmp_path / "own.yml")]
    assert config_of(*flags, "--seed", "4") == replace(own, seed=4)
    # The cluster is no part of a run.
    request = parse_arguments(["--cluster", "auto", "--seeds", "2"])
    assert request.cluster == "auto"
    assert request.config == replace(configs.defaults("sort", "ppo"), seeds=2)


def test_a_search_is_new_or_resumed(tmp_path) -> None:
    file, folder = tmp_path / "wide.yml", tmp_path / "search-wide"
    request = parse_arguments(["--search", str(file), "--out", str(tmp_path)])
    assert request == Request(None, None, search=file, folder=folder)
    folder.mkdir()
    (folder / SWEEP).touch()
    found = parse_arguments(["--resume", str(folder)])
    assert found == Request(None, None, search=folder / SWEEP, folder=folder)


def test_a_search_without_optuna_says_what_to_install(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(train_cli, "find_spec", lambda _: None)
    with pytest.raises(SystemExit, match=r"pip install 'surface_gym\[search\]'"):
        train_cli.main(["--search", "wide.yml", "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_the_command_of_a_card_trains_the_same(tmp_path) -> None:
    config = config_of("--device", "cuda", "--num-envs", "32768", "--out", str(tmp_path))
    assert isinstance(config, algorithms.PPOConfig)
    command = runs.training_command(config)
    assert command.endswith("--task sort --algo ppo --device cuda --num-envs 32768")
    assert config_of(*command.split()[2:]) == replace(config, out=Path("runs"))
    trained = [runs.TrainResult(steps=100, seconds=1.4, interrupted=False)]
    runs.write_card(config, trained, {"exact": {"success": 1.0}}, tmp_path)
    assert yaml.safe_load((tmp_path / "card.yaml").read_text()) == {
        "command": command, "seeds": [0], "steps": [100], "seconds": [1],
        "results": {"exact": {"success": 1.0}},
    }  # fmt: skip
