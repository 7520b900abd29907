"""The request of a search: YAML that is understood, and refusals that name what is wrong."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from optuna.distributions import FloatDistribution, IntDistribution

from surface_gym.agents.learning.algorithms import PPOConfig
from surface_gym.agents.learning.config import defaults
from surface_gym.agents.tuning.sweep import SearchConfig, differences, make_choices, read_sweep

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "sweep.yml"
RATE = {"learning_rate": FloatDistribution(1e-4, 1e-3)}


def test_the_example_is_the_defaults_with_a_space() -> None:
    sweep = read_sweep(EXAMPLE)
    assert sweep == SearchConfig(space=sweep.space, fixed=sweep.fixed)
    assert sweep.fixed == {"num_envs": 256, "batch_size": 2048}
    assert sweep.space == {
        "learning_rate": FloatDistribution(1e-4, 3e-3, log=True),
        "gamma": make_choices([0.97, 0.98, 0.99, 0.995]),
        "n_steps": make_choices([32, 64, 128]),
        "ent_coef": FloatDistribution(1e-4, 0.03, log=True),
        "n_epochs": IntDistribution(3, 10),
        "hidden": make_choices([[64, 64], [128, 128]]),
    }
    assert f"```yaml\n{EXAMPLE.read_text()}```" in (ROOT / "docs" / "search.md").read_text()


def test_the_configuration_of_drawn_values() -> None:
    """A batch that fits no default may fit what is drawn."""
    sweep = SearchConfig(
        task="track", seed=3, fixed={"gamma": 0.9}, space={"hidden": make_choices([[8], [9]])}
    )
    usual = defaults("track", "ppo")
    assert isinstance(usual, PPOConfig)
    expected = replace(usual, steps=200_000, seed=3, gamma=0.9, hidden=(8,))
    assert sweep.config({"hidden": [8]}) == expected
    sweep = SearchConfig(fixed={"batch_size": 768}, space={"n_steps": make_choices([48, 64])})
    assert sweep.config({"n_steps": 48})
    with pytest.raises(ValueError, match="batch_size must be a factor"):
        sweep.config({"n_steps": 64})


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"algo": "schedule"}, "algo must be one of 'ppo', 'dqn', 'modules'"),
        ({"metric": "time"}, "metric"),
        ({"sampler": "grid"}, "sampler"),
        ({"pruner": "hyperband"}, "pruner"),
        ({"trials": 0}, "trials"),
        ({"evaluations": 0}, "evaluations"),
        ({"seeds": 0}, "seeds"),
        ({"seed": -1}, "seed"),
        ({"startup_trials": -1}, "startup_trials"),
        ({"steps": 59_999}, "steps, with 5 evaluations, must be a whole number of at least 60000"),
        ({"space": {}}, "space must name"),
        (
            {"space": {"momentum": FloatDistribution(0.0, 1.0)}},
            "a name in space must be one of 'actions'",
        ),
        ({"space": {"steps": IntDistribution(1, 2)}}, "a name in space"),
        ({"fixed": {"buffer_size": 5}}, "a name in fixed"),
        ({"fixed": {"learning_rate": 1e-3}}, "fixed must name nothing that space does"),
        ({"fixed": {"gamma": 1.5}}, "fixed: gamma must be between 0 and 1"),
        ({"fixed": {"batch_size": 1000}}, "fixed: batch_size must be a factor"),
        ({"fixed": {"hidden": 64}}, "fixed: 'int' object is not iterable"),
        (
            {"space": {"gamma": FloatDistribution(0.9, 1.1)}},
            "space: gamma must be between 0 and 1, got 1.1",
        ),
        (
            {"space": {"n_epochs": FloatDistribution(1.0, 3.0)}},
            "space: n_epochs must be a whole number",
        ),
        (
            {"space": {"batch_size": make_choices([64, 0])}},
            "space: batch_size must be a whole number",
        ),
        ({"task": "slow", "algo": "modules"}, "task must be one of 'sort' for modules"),
    ],
    ids=str,
)
def test_what_is_not_allowed_is_named(change, named) -> None:
    with pytest.raises(ValueError, match=named):
        SearchConfig(**{"space": RATE, **change})


@pytest.mark.parametrize(
    ("values", "named"),
    [
        (3, "low, high, log"),
        ({"low": 1}, "low, high, log"),
        ({"low": 1, "high": 2, "step": 1}, "low, high, log"),
        ({"low": 2, "high": 1}, "`low <= high` must hold, but got .*low=2, high=1"),
        ({"low": "1e-4", "high": 1}, "low must be a finite number, got '1e-4'"),
        (
            {"low": 0, "high": 1, "log": True},
            "must hold for `log=True`",
        ),
        ({"low": 1, "high": 2, "log": "yes"}, "log must be one of"),
        ({"choices": [1]}, "two or more"),
        ({"choices": 5}, "two or more"),
        ({"choices": [1, 1]}, "two or more different"),
        ({"choices": [1, {2}]}, "plain values"),
    ],
    ids=str,
)
def test_ranges_that_are_none(values, named, tmp_path) -> None:
    file = tmp_path / "sweep.yml"
    file.write_text(yaml.safe_dump({"space": {"gamma": values}}))
    with pytest.raises(ValueError, match=r"sweep\.yml.*space: gamma: .*" + named):
        read_sweep(file)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (None, ""),  # there is none
        ("", "names and values"),
        ("- 1", "names and values"),
        ("[1", "flow sequence"),
        ("rounds: 3", "a name must be one of 'task'"),
        ("space: 3", "space must hold names and values"),
        ("fixed: [1]", "fixed must hold names and values"),
        ("task: juggle", "task must be one of sort"),
        ("task: own.py:Own", "a custom one that --task names too"),
        ("!!python/object/apply:os.getcwd []", "could not determine a constructor"),
    ],
)
def test_a_foreign_file_is_refused(text, named, tmp_path) -> None:
    if text is not None:
        (tmp_path / "sweep.yml").write_text(text)
    with pytest.raises(ValueError, match=r"sweep\.yml.*" + named):
        read_sweep(tmp_path / "sweep.yml")


def test_a_custom_task_is_named_twice(tmp_path) -> None:
    task = f"{ROOT}/examples/reach.py:Reach"
    file = tmp_path / "sweep.yml"
    file.write_text(f"task: {task}\nspace: {{gamma: {{low: 0.9, high: 0.99}}}}\n")
    assert read_sweep(file, task).task == task
    with pytest.raises(ValueError, match="--task"):
        read_sweep(file)


def test_differences_are_named() -> None:
    assert differences(SearchConfig(space=RATE), SearchConfig(space=RATE)) == []
    (found,) = differences(SearchConfig(space=RATE), SearchConfig(space=RATE, trials=30))
    assert found == "trials is 20 there, 30 here"
