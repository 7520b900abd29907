"""The lab as a condition of the comparison: starts that leave open which parcel it is."""

import math
from pathlib import Path

import numpy as np
import pytest

from agents import library
from agents.evaluation.cell import play, trial_of
from agents.evaluation.columns import columns_of
from agents.evaluation.contenders import of_run, rules, shipped
from agents.evaluation.drawn import drawn_parcels
from agents.evaluation.summary import Summary
from agents.evaluation.table import value_of
from agents.evaluation.trials import SEED, make_trial
from agents.learning.config import PPOConfig
from agents.learning.folder import CONFIG
from agents.learning.hyperparams import write_config
from agents.policies.files import save_policy
from agents.policies.policy import make_network
from agents.policy_card import PolicyCard
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.conditions import CONDITIONS, Condition
from surface_gym.registration import env_id
from surface_gym.settings import Settings

LAB = CONDITIONS["lab"]
PARCELS_ALONE = Condition("parcels", "parcels", "The lab's parcels.", parcels=LAB.parcels)
LINES = ("sort", "slow", "stop", "orient")


@pytest.mark.parametrize("task", LINES)
def test_starts_leave_the_parcel_open_and_keep_the_rest(task: str) -> None:
    trial = make_trial(task)
    assert trial.under(CONDITIONS["camera"]) is trial
    opened = trial.under(LAB)
    assert len(opened.starts) == len(trial.starts)
    for before, after in zip(trial.starts, opened.starts, strict=True):
        assert {**after, "parcel": before.get("parcel")} == {"parcel": None, **before}
        assert "parcel" not in after


@pytest.mark.parametrize("task", LINES)
def test_parcels_are_those_that_the_environment_draws(task: str) -> None:
    """A parcel enters with its rear at x = 0."""
    starts = make_trial(task).under(LAB).starts[::7]
    settings = Settings(task=task, condition=PARCELS_ALONE)
    drawn = drawn_parcels(settings, starts, SEED)
    env = SmartSurfaceVectorEnv(len(starts), task=task, condition=PARCELS_ALONE)
    _, info = env.reset(seed=SEED, options=list(starts))
    from_rear = [parcel.base.centroid[0] - parcel.base.outline[:, 0].min() for parcel in drawn]
    np.testing.assert_allclose(info["pose"][:, 0], from_rear, atol=1e-12)
    assert len(set(drawn)) > 0.3 * len(starts)


def test_a_start_that_says_its_parcel_has_it() -> None:
    settings = Settings(task="sort", condition=LAB)
    sizes = [parcel.rear for parcel in drawn_parcels(settings, [{"parcel": "S"}] * 3, SEED)]
    assert sizes == [0.125] * 3


def test_sort_in_the_lab() -> None:
    event = next(rule for rule in rules("sort") if rule.name == "event rule")
    cell, _ = play(event, 0, "lab")
    assert len(cell.success) == len(trial_of(event).starts)
    assert np.mean(cell.success) > 0.9
    assert min(cell.columns) >= 0
    summary = Summary((cell,))
    values = {column.name: value_of(column, summary, summary) for column in columns_of("sort")}
    of_boxes = {name: value for name, value in values.items() if name[-2:] in ("_S", "_B")}
    assert len(of_boxes) == 6
    assert all(math.isnan(value) for value in of_boxes.values())
    assert 3.0 < values["columns"] < 16.0
    assert values["parcels_an_hour"] > 1000.0


def _leave(folder: Path, task: str, observe: tuple[str, ...] = ()) -> None:
    """A policy that has learned nothing."""
    card = PolicyCard(env_id(task), "ppo", "halves", 0.04, (8,), observe)
    folder.mkdir(parents=True)
    save_policy(make_network(card, card.settings()), card, folder)


def test_agents_of_the_lab_are_found_on_the_shelf(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, observe in (("slow-ppo-lab", ("parcel", "rotors")), ("slow-ppo", ())):
        for seed in (0, 1):
            _leave(tmp_path / name / f"seed-{seed}", "slow", observe)
        (tmp_path / name / "card.yaml").touch()
    monkeypatch.setattr(library, "SHELF", tmp_path)
    nominal, lab = shipped("slow")
    assert (nominal.name, lab.name) == ("PPO", "PPO, lab")
    assert (nominal.observe, lab.observe) == ((), ("parcel", "rotors"))
    assert lab.seeds == (0, 1)
    trial = make_trial("slow").some(3)
    settings = lab.settings(trial, LAB)
    env = SmartSurfaceVectorEnv(
        2, task="slow", actions="halves", observe=settings.observe, condition=LAB
    )
    observation, _ = env.reset(seed=0)
    assert lab.make(settings, 1).predict(observation)[0] in env.action_space


def test_a_run_is_named_by_what_it_is_to_be_ready_for(tmp_path: Path) -> None:
    _leave(tmp_path / "run", "slow", ("parcel",))
    assert of_run(tmp_path / "run").name == "PPO"
    config = PPOConfig(task="slow", condition="lab", observe=("parcel",))
    write_config(config, tmp_path / "run" / CONFIG)
    found = of_run(tmp_path / "run")
    assert (found.name, found.observe) == ("PPO, lab", ("parcel",))
