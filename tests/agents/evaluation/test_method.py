"""Methods: rules, planners and agents of each task, the shipped and those of runs."""

from pathlib import Path

import numpy as np
import pytest

from surface_gym.agents import library
from surface_gym.agents.evaluation import method as methods
from surface_gym.agents.evaluation.method import all_methods, of_run, rivals, shipped
from surface_gym.agents.learning.algorithms import PPOConfig
from surface_gym.agents.learning.runs import CONFIG, write_config
from surface_gym.agents.library import PolicyCard, save_policy
from surface_gym.agents.policy import make_network
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS

LAB = PRESETS["lab"]


def test_methods_of_a_task_without_agents() -> None:
    several = all_methods("park")
    assert [each.name for each in several] == [
        "fixed layout", "parking rule", "belief planner", "planner",
    ]  # fmt: skip
    assert [each.name for each in rivals(several)] == ["fixed layout", "parking rule"]


@pytest.mark.parametrize("task", [task for task in TASKS if task != "park"])
def test_methods_of_a_task_of_one_parcel(task) -> None:
    several = all_methods(task)
    names = [method.name for method in several]
    assert (names[:2], names[-1]) == (["fixed layout", "best fixed layout"], "planner")
    assert {"PPO", "DQN"} < set(names)
    assert ("fixed layout, any angle" in names, len(set(names))) == (task == "sort", len(names))
    assert all(len(each.seeds) >= 3 for each in several if each.name in ("PPO", "DQN"))
    assert [each.presets for each in several[-2:]] == [("lab",), ("exact",)]
    assert several[-2].name == "belief planner"
    assert [each.name for each in rivals(several)] == ["fixed layout", "PPO"]


@pytest.mark.parametrize(
    ("task", "rule"),
    [("singulate", "time slots"), ("merge", "time slots"), ("sequence", "pass and park")],
)
def test_methods_of_a_task_on_streams(task, rule) -> None:
    several = {each.name: each for each in all_methods(task)}
    kinds = [each.kind for each in several.values()]
    assert kinds == sorted(kinds, key=("baseline", "rule", "agent", "planner").index)
    assert {"roll on", rule, "PPO per parcel", "planner"} <= set(several)
    agent, planner = several["PPO per parcel"], several["planner"]
    assert (agent.arguments["actions"], agent.arguments["max_parcels"]) == ("parcels", 12)
    assert (planner.most, planner.presets) == (3, ("exact", "lab"))
    assert [each.kind for each in rivals(several.values())] == ["rule", "agent"]


def test_parcels_that_roll_on_all_turn_one_way() -> None:
    config = EnvConfig("merge", actions="parcels")
    action, _ = methods.RollOn(config).predict(np.zeros((3, 32, 30), dtype=np.float32))
    assert (action.shape, set(action.ravel().tolist())) == ((3, 64), {3})
    assert methods.RollOn(config).predict(np.zeros((32, 30)))[0].shape == (64,)


def _leave(folder: Path, task: str, observe: tuple[str, ...] = ()) -> None:
    """A policy that has learned nothing."""
    card = PolicyCard(env_id(task), "ppo", "halves", 0.04, (8,), observe)
    folder.mkdir(parents=True)
    save_policy(make_network(card, card.env_config()).state_dict(), card, folder)


def test_agents_of_a_preset_are_found_among_the_shipped(tmp_path, monkeypatch) -> None:
    """And a run is named by its preset."""
    for name, observe in (("slow-ppo-lab", ("parcel", "rotors")), ("slow-ppo", ())):
        for seed in (0, 1):
            _leave(tmp_path / name / f"seed-{seed}", "slow", observe)
        (tmp_path / name / "card.yaml").touch()
    monkeypatch.setattr(library, "SHELF", tmp_path)
    nominal, lab = shipped("slow")
    assert (nominal.name, nominal.arguments.get("observe")) == ("PPO", None)
    assert (lab.name, lab.arguments["observe"]) == ("PPO, lab", ("parcel", "rotors"))
    assert lab.seeds == (0, 1)
    config = lab.config(TASKS["slow"](), LAB)
    observation = config.observation_space().sample()
    assert lab.controller(config, 1).predict(observation)[0] in config.action_space()

    run = tmp_path / "slow-ppo-lab" / "seed-0"
    assert of_run(run).name == "PPO"
    write_config(PPOConfig(task="slow", preset="lab", observe=("parcel", "rotors")), run / CONFIG)
    assert of_run(run).name == "PPO, lab"


@pytest.mark.parametrize("text", [None, "", "[1", "env_id: SmartSurface/Sort-v0", "- a"])
def test_a_run_without_a_policy_is_refused(tmp_path, text) -> None:
    _leave(tmp_path / "run", "slow")
    card = tmp_path / "run" / library.CARD
    if text is None:
        card.unlink()
    else:
        card.write_text(text)
    with pytest.raises(ValueError, match=r"holds (no|a damaged or foreign) policy"):
        of_run(tmp_path / "run")


@pytest.mark.parametrize(
    ("task", "of"), [("flow", methods.start_benchmark), ("sort", methods.stream_benchmark)]
)
def test_a_benchmark_of_another_kind_is_refused(task, of) -> None:
    with pytest.raises(ValueError, match=r"^task must be one o[fn] (a single parcel|streams)"):
        of(task)
