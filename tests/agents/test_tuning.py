"""A search: its file; what is sampled, pruned and kept, however interrupted; its report."""

import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import optuna
import pytest
import yaml
from optuna.distributions import FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, TrialState, create_trial
from rich.console import Console

from surface_gym.agents import tuning
from surface_gym.agents.evaluation.scenario import SEED
from surface_gym.agents.learning.algorithms import PPOConfig
from surface_gym.agents.learning.config import defaults, make_card
from surface_gym.agents.learning.runs import TrainResult, train
from surface_gym.agents.library import read
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.tuning import SearchConfig, make_choices, read_sweep, search
from surface_gym.executors import Report
from surface_gym.tasks.benchmark import DRAWN
from tests.agents.searches import QUIET, SMALL, cheap_trial, searched

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "sweep.yml"
RATE = {"learning_rate": FloatDistribution(1e-4, 1e-3)}
RANDOM = replace(SMALL, trials=12, startup_trials=12)


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
    assert '--8<-- "examples/sweep.yml"' in (ROOT / "docs" / "search.md").read_text()


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
        ({"trials": 0}, "trials"),
        ({"evaluations": 0}, "evaluations"),
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
        ("rounds: 3", "a name must be one of 'task'"),
        ("space: 3", "space must hold names and values"),
        ("fixed: [1]", "fixed must hold names and values"),
        ("task: juggle", "task must be one of sort"),
        ("task: own.py:Own", "a custom one that --task names too"),
    ],
)
def test_a_foreign_file_is_refused(text, named, tmp_path) -> None:
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


def trial(values: dict[int, float], state: TrialState = TrialState.COMPLETE) -> FrozenTrial:
    """A trial with values on the way, the last of which is its value."""
    value = values[max(values)] if state == TrialState.COMPLETE else None
    return create_trial(state=state, value=value, intermediate_values=values)


def finished(folder: Path, sweep: SearchConfig = SMALL) -> tuple[FrozenTrial, ...]:
    """The trials that a folder holds."""
    with tuning.open_study(sweep, folder) as kept:
        return tuple(tuning.finished_trials(kept))


class TestTrials:
    def test_values_lie_in_the_space_and_tpe_finds_better_ones(self, tmp_path) -> None:
        sweep = replace(SMALL, trials=40, seed=0)
        trials = searched(sweep, tmp_path)
        assert [each.number for each in trials] == list(range(40))
        for each in trials:
            params = sweep.plain_params(each.params)
            assert 1e-4 <= params["learning_rate"] <= 1e-2
            assert params["n_epochs"] in range(1, 10)
            assert params["hidden"] in ([8], [8, 8])
        rates = [each.params["learning_rate"] for each in trials]
        assert np.mean(rates[-10:]) > 2.0 * np.mean(rates[:10])

    def test_the_seed_decides(self, tmp_path) -> None:
        few = replace(SMALL, trials=7)
        found = []
        for number, sweep in enumerate((few, few, replace(few, seed=1))):
            (tmp_path / str(number)).mkdir()
            found.append([each.params for each in searched(sweep, tmp_path / str(number))])
        assert found[0] == found[1] != found[2]

    def test_refused_and_failed_trials_are_kept_with_their_reasons(self, tmp_path) -> None:
        trials = searched(RANDOM, tmp_path, refused_or_failed)
        states = {tuning.describe_state(each) for each in trials}
        assert states == {"refused: no", "failed: nan", "complete"}
        assert len(finished(tmp_path, RANDOM)) == len(trials) == 12

    def test_the_best_is_the_first_of_equals(self) -> None:
        pruned = trial({1: 0.9}, TrialState.PRUNED)
        trials = [trial({1: 0.2}), pruned, trial({1: 0.5}), trial({1: 0.5})]
        for number, each in enumerate(trials):
            each.number = number
        assert tuning.best_trial(trials) is trials[2]
        assert tuning.best_trial([pruned]) is None


def refused_or_failed(
    sweep: SearchConfig, params: dict[str, Any], past: tuple[FrozenTrial, ...], report: Report
) -> tuning.TrialResult:
    """Two trials of three end otherwise."""
    if params["n_epochs"] % 3 == 0:
        return tuning.TrialResult(TrialState.FAIL, why="refused: no")
    if params["n_epochs"] % 3 == 1:
        return tuning.TrialResult(TrialState.FAIL, why="failed: nan")
    return cheap_trial(sweep, params, past, report)


class TestPruning:
    past = tuple(trial({1: 0.1 * k, 2: 0.2 * k, 3: 0.3 * k}) for k in range(4))

    def pruning(self, past: tuple[FrozenTrial, ...]) -> tuning.Pruning:
        return tuning.Pruning(SMALL, past, lambda _: None)

    def test_below_the_median_of_complete_trials_it_ends(self) -> None:
        prune = self.pruning(())  # nothing is pruned without others
        assert not any(prune(number, 0.0) for number in (1, 2, 3))
        assert self.pruning(self.past)(1, 0.14)
        pruned = tuple(trial({1: 9.0}, TrialState.PRUNED) for _ in range(4))
        prune = self.pruning(self.past + pruned)
        assert not prune(1, 0.16)
        assert prune(2, 0.29)
        assert not self.pruning(self.past[:3])(1, 0.0)  # too few


class TestResuming:
    @pytest.mark.parametrize("at", [0, 5, 13])
    def test_interrupted_trials_run_once_more_and_finished_ones_do_not(self, at, tmp_path) -> None:
        before = searched(SMALL, tmp_path, partial(stopping, at))
        assert len(before) == at + 1
        trials = searched(SMALL, tmp_path)
        for one, other in zip(before[:at], trials, strict=False):
            assert (one.params, one.datetime_complete) == (other.params, other.datetime_complete)
        assert trials[at].state == TrialState.FAIL
        assert trials[at + 1].params == trials[at].params == before[at].params
        assert len(finished(tmp_path)) == 14
        assert searched(SMALL, tmp_path) == trials  # nothing is left to do

    def test_a_killed_search_of_several_workers_is_resumed(self, tmp_path) -> None:
        call = (
            "import sys; from pathlib import Path; from tests.agents.searches import "
            "slow_search\nif __name__ == '__main__': slow_search(Path(sys.argv[1]))"
        )
        (tmp_path / "go.py").write_text(call)
        command = [sys.executable, str(tmp_path / "go.py"), str(tmp_path)]
        process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)})
        found: list[tuple[int, float | None]] = []
        while process.poll() is None and len(found) < 2:
            time.sleep(0.2)
            found = look(tmp_path / tuning.STUDY)
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL  # before it was done
        trials = searched(SMALL, tmp_path)
        assert [each.number for each in trials] == list(range(len(trials)))
        assert [(number, trials[number].value) for number, _ in found] == found
        kept = finished(tmp_path)
        assert len(kept) == 14
        assert {each.state for each in kept} == {TrialState.COMPLETE, TrialState.PRUNED}
        assert all(each.intermediate_values for each in kept)


def look(file: Path) -> list[tuple[int, float | None]]:
    """Number and value of each trial that has ended, read beside the process that writes them.

    Optuna would make tables that are missing, as the process may just do itself.
    """
    query = (
        "SELECT number, value FROM trials LEFT JOIN trial_values USING (trial_id) "
        "WHERE state IN ('COMPLETE', 'PRUNED') ORDER BY number"
    )
    try:
        with closing(sqlite3.connect(f"{file.as_uri()}?mode=ro", uri=True)) as tables:
            return tables.execute(query).fetchall()
    except sqlite3.OperationalError:  # its tables are not there yet, or are being written to
        return []


def stopping(
    at: int,
    sweep: SearchConfig,
    params: dict[str, Any],
    past: tuple[FrozenTrial, ...],
    report: Report,
) -> tuning.TrialResult:
    if len(past) == at:
        raise KeyboardInterrupt
    return cheap_trial(sweep, params, past, report)


SWEEP = SearchConfig(
    task="stop", steps=30_000, evaluations=2, startup_trials=1, metric="return",
    space={"learning_rate": FloatDistribution(1e-4, 1e-2), "n_steps": make_choices([24, 32, 64])},
    fixed={"hidden": [8], "n_epochs": 1},
)  # fmt: skip
PARAMS = {"learning_rate": 1e-3, "n_steps": 32}


class TestTrial:
    """One trial: evaluations on the way, a judgement by fresh starts, and the ways it can end."""

    @pytest.fixture(autouse=True)
    def few_starts(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(tuning, "STARTS", 32)

    def run(
        self, sweep: SearchConfig = SWEEP, past: Any = (), params: Any = PARAMS, **changed: Any
    ) -> tuple[tuning.TrialResult, Any]:
        reported: list[tuple[int, float]] = []
        return tuning.run_trial(sweep, {**params, **changed}, past, reported.append), reported

    def test_it_is_complete_and_the_same_again_but_ends_below_the_median(self) -> None:
        result, reported = self.run()
        assert (result.state, result.why) == (TrialState.COMPLETE, "")
        assert result.value is not None
        assert np.isfinite(result.value)
        assert [number for number, _ in reported] == [1, 2]
        assert self.run() == (result, reported)
        result, reported = self.run(past=(trial({1: 100.0, 2: 100.0}),))
        assert result == tuning.TrialResult(TrialState.PRUNED)
        assert [number for number, _ in reported] == [1]

    def test_a_configuration_that_is_not_allowed_is_refused(self) -> None:
        result, reported = self.run(n_steps=25)
        assert (result.state, result.value, reported) == (TrialState.FAIL, None, [])
        assert result.why.startswith("refused: batch_size must be a factor")

    @pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers that grow too large
    def test_weights_that_are_not_finite_fail_the_trial_alone(self) -> None:
        result, _ = self.run(learning_rate=1e30)
        assert (result.state, result.value) == (TrialState.FAIL, None)
        assert re.match("failed: .*invalid values", result.why)

    def test_an_interrupt_is_passed_on(self, monkeypatch) -> None:
        monkeypatch.setattr(tuning, "train", lambda *_: TrainResult(0, 0.0, True))
        with pytest.raises(KeyboardInterrupt):
            self.run()

    @pytest.mark.parametrize(
        ("algo", "task", "fixed"),
        [
            ("dqn", "stop", {"hidden": [8], "gradient_steps": 1, "batch_size": 32}),
            ("modules", "sort", {"hidden": [8], "n_epochs": 1, "camera_share": 0.0}),
        ],
    )
    def test_other_algorithms(self, algo, task, fixed) -> None:
        space = {"gamma": make_choices([0.9, 0.99])}
        sweep = SearchConfig(
            algo=algo, task=task, steps=20_000, evaluations=1, space=space, fixed=fixed
        )
        result, reported = self.run(sweep, params={"gamma": 0.9})
        assert result.state == TrialState.COMPLETE
        assert result.value is not None
        assert 0.0 <= result.value <= 1.0
        assert [number for number, _ in reported] == [1]


def test_a_policy_is_judged_by_starts_of_their_own(tmp_path, monkeypatch) -> None:
    """By the share that succeed, whatever was learned from; nothing is compared on them."""
    sweep = replace(SWEEP, task="sort", metric="success", seed=5, fixed={"camera_share": 0.0})
    config = PPOConfig(steps=15_000, camera_share=0.0, hidden=(16,))
    train(config, tmp_path)
    monkeypatch.setattr(tuning, "STARTS", 100)
    policy, seed = read(tmp_path), tuning.JUDGE_SEED + 5
    alone = run_episodes(policy, make_card(config).env_config(), [{}] * 100, seed)
    judged = tuning.score_policy(config, sweep, tmp_path)
    assert judged == alone.success.mean()
    assert 0.0 < judged < 1.0
    other = replace(config, camera_share=1.0, friction=0.9, num_envs=128, seed=9)
    assert tuning.score_policy(other, sweep, tmp_path) == judged
    with pytest.raises(ValueError, match="between 0 and 2"):
        np.random.RandomState(tuning.JUDGE_SEED)  # what Stable-Baselines3 learns by
    monkeypatch.undo()
    assert SEED + DRAWN + tuning.STARTS < tuning.JUDGE_SEED


SHORT = """
task: slow
trials: 2
steps: 20000
evaluations: 1
space: {learning_rate: {low: 0.0001, high: 0.003}}
fixed: {hidden: [8], n_epochs: 1}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "short.yml"
    file.write_text(SHORT)
    return file


def printed(file: Path, folder: Path) -> str:
    """What a search prints."""
    with open(os.devnull, "w") as nowhere:
        console = Console(record=True, width=200, file=nowhere)
        search(file, folder, 1, console)
        return console.export_text()


def test_it_leaves_a_configuration_that_learns(file, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("surface_gym.agents.tuning.STARTS", 16)
    folder = tmp_path / "a"
    text = printed(file, folder)
    assert "the best is trial" in text
    assert "report.md and best.yml" in text
    with tuning.open_study(SMALL, folder) as kept:
        best = tuning.best_trial(tuning.finished_trials(kept))
    config, usual = defaults("slow", "ppo", folder / "best.yml"), defaults("slow", "ppo")
    assert isinstance(usual, PPOConfig)
    rate = best.params["learning_rate"]
    assert config == replace(usual, hidden=(8,), n_epochs=1, learning_rate=rate)
    texts = {name: (folder / name).read_bytes() for name in ("report.md", "best.yml")}
    names = {each.name for each in folder.iterdir()}
    assert names == {*texts, "sweep.yml", "study.db", "history.png", "curves.png"}
    search(folder / "sweep.yml", folder, 1, QUIET)  # which has nothing left to do
    assert {name: (folder / name).read_bytes() for name in texts} == texts


def test_an_interrupt_is_reported(file, tmp_path, monkeypatch) -> None:
    def stop(*_: object) -> Iterator[None]:
        raise KeyboardInterrupt

    monkeypatch.setattr("surface_gym.agents.tuning.run_trial", stop)
    expected = f"holds 0 trials; python train.py --resume {tmp_path / 'a'} resumes it"
    assert expected in printed(file, tmp_path / "a")


def test_a_search_without_workers_is_refused(file, tmp_path) -> None:
    with pytest.raises(ValueError, match="workers"):
        search(file, tmp_path / "a", 0, QUIET)
    assert not (tmp_path / "a").exists()


REPORTED = replace(SMALL, trials=24)


def in_memory(*trials: FrozenTrial) -> optuna.Study:
    study = optuna.create_study(direction="maximize")
    study.add_trials(trials)
    return study


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> list[FrozenTrial]:
    return searched(REPORTED, tmp_path_factory.mktemp("report"))


def table(page: str, head: str) -> list[list[str]]:
    """The rows of the table of a page that begins with a column's name."""
    text = page[page.index(f"\n| {head} |") + 1 :].partition("\n\n")[0]
    return [
        [value.strip() for value in line.strip().strip("|").split("|")]
        for line in text.splitlines()[2:]
    ]


class TestReport:
    def test_the_page_lists_every_trial_and_the_best(self, trials, tmp_path) -> None:
        interrupted = create_trial(state=TrialState.FAIL)
        style = matplotlib.rcParams.copy()
        tuning.write_report(REPORTED, in_memory(*trials, interrupted), tmp_path)
        assert {**matplotlib.rcParams, "backend": style["backend"]} == style
        page = (tmp_path / "report.md").read_text()
        best = tuning.best_trial(trials)
        assert f"## Best: trial {best.number}, success {best.value:.4g}" in page
        rows = table(page, "trial")
        assert [row[:2] for row in rows] == [[str(t.number), t.state.name.lower()] for t in trials]
        assert float(rows[best.number][2]) == pytest.approx(best.value, rel=1e-3)
        for picture in ("history.png", "curves.png"):
            assert f"![]({picture})" in page
            assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
        config = defaults(REPORTED.task, REPORTED.algo, tmp_path / "best.yml")
        usual = defaults(REPORTED.task, REPORTED.algo)
        found = REPORTED.config(REPORTED.plain_params(best.params))
        assert config == replace(found, steps=usual.steps, seed=usual.seed)

    def test_without_a_complete_trial_there_is_no_best(self, trials, tmp_path) -> None:
        given = {"params": trials[0].params, "distributions": trials[0].distributions}
        refused = create_trial(
            state=TrialState.FAIL, user_attrs={tuning.REASON: "refused: a | b"}, **given
        )
        pruned = create_trial(state=TrialState.PRUNED, intermediate_values={1: 0.5}, **given)
        tuning.write_report(REPORTED, in_memory(refused, pruned), tmp_path)
        page = (tmp_path / "report.md").read_text()
        assert "1 pruned, 1 refused; none is complete, so none is best" in page
        assert table(page, "trial")[0][1] == "refused: a / b"
        names = {each.name for each in tmp_path.iterdir()}
        assert names == {"report.md", "history.png", "curves.png"}
