"""A study: what is sampled, pruned and kept, however it is interrupted; and one real trial."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.trial import FrozenTrial, TrialState, create_trial

from surface_gym.agents.evaluation.benchmark import SEED
from surface_gym.agents.learning.config import PPOConfig, make_card
from surface_gym.agents.learning.runs import TrainResult, train
from surface_gym.agents.policy import load_policy
from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.tuning import study
from surface_gym.agents.tuning.study import TrialResult
from surface_gym.agents.tuning.sweep import Choices, Span, Sweep
from surface_gym.parallel import Report
from surface_gym.tasks.benchmark import DRAWN
from tests.agents.tuning.cheap import SMALL, cheap_trial, searched

ROOT = Path(__file__).parents[3]
RANDOM = replace(SMALL, sampler="random", pruner="none", trials=12)


def trial(values: dict[int, float], state: TrialState = TrialState.COMPLETE) -> FrozenTrial:
    """A trial with values on the way, the last of which is its value."""
    value = values[max(values)] if state == TrialState.COMPLETE else None
    return create_trial(state=state, value=value, intermediate_values=values)


class TestTrials:
    def test_values_lie_in_the_space_and_tpe_finds_better_ones(self, tmp_path) -> None:
        sweep = replace(SMALL, trials=40, seed=0, pruner="none")
        trials = searched(sweep, tmp_path)
        assert [each.number for each in trials] == list(range(40))
        for each in trials:
            params = study.plain_params(sweep, each)
            assert 1e-4 <= params["learning_rate"] <= 1e-2
            assert params["n_epochs"] in range(1, 10)
            assert params["hidden"] in ([8], [8, 8])
        values = [each.value for each in trials]
        assert np.mean(values[-10:]) > 2.0 * np.mean(values[:10])

    @pytest.mark.parametrize("change", [{"seed": 1}, {"sampler": "random", "pruner": "none"}])
    def test_the_seed_and_the_sampler_decide(self, change, tmp_path) -> None:
        found = []
        for name, sweep in (("a", SMALL), ("b", replace(SMALL, **change)), ("c", SMALL)):
            (tmp_path / name).mkdir()
            found.append([each.params for each in searched(sweep, tmp_path / name)])
        assert found[0] == found[2] != found[1]

    def test_refused_and_failed_trials_are_kept_with_their_reasons(self, tmp_path) -> None:
        trials = searched(RANDOM, tmp_path, refused_or_failed)
        assert {study.describe_state(each) for each in trials} == {
            "refused: no",
            "failed: nan",
            "complete",
        }
        with study.open_study(RANDOM, tmp_path) as kept:
            assert len(study.finished_trials(kept)) == len(trials) == 12

    def test_the_best_is_the_first_of_equals(self) -> None:
        trials = [trial({1: 0.2}), trial({1: 0.9}, TrialState.PRUNED), trial({1: 0.5})]
        trials.append(trial({1: 0.5}))
        for number, each in enumerate(trials):
            each.number = number
        assert study.best_trial(trials) is trials[2]
        assert study.best_trial(trials[1:2]) is None


def refused_or_failed(
    sweep: Sweep, params: dict[str, Any], past: tuple[FrozenTrial, ...], report: Report
) -> TrialResult:
    """Two trials of three end otherwise."""
    if params["n_epochs"] % 3 == 0:
        return TrialResult(study.REFUSED, why="no")
    if params["n_epochs"] % 3 == 1:
        return TrialResult(study.FAILED, why="nan")
    return cheap_trial(sweep, params, past, report)


class TestPruning:
    past = tuple(trial({1: 0.1 * k, 2: 0.2 * k, 3: 0.3 * k}) for k in range(4))

    def pruning(self, pruner: str, past: tuple[FrozenTrial, ...]) -> study.Pruning:
        return study.Pruning(replace(SMALL, pruner=pruner), past, lambda _: None)

    @pytest.mark.parametrize("pruner", ["median", "halving", "none"])
    def test_nothing_is_pruned_without_others(self, pruner) -> None:
        prune = self.pruning(pruner, ())
        assert not any(prune(number, 0.0) for number in (1, 2, 3))

    def test_below_the_median_of_complete_trials_it_ends(self) -> None:
        assert self.pruning("median", self.past)(1, 0.14)
        pruned = tuple(trial({1: 9.0}, TrialState.PRUNED) for _ in range(4))
        prune = self.pruning("median", self.past + pruned)
        assert not prune(1, 0.16)
        assert prune(2, 0.29)
        assert not self.pruning("median", self.past[:3])(1, 0.0)  # too few
        assert not self.pruning("none", self.past)(1, 0.0)

    def test_halving_lets_the_best_quarter_of_a_rung_on(self, tmp_path) -> None:
        searched(replace(SMALL, pruner="halving"), tmp_path)
        with study.open_study(SMALL, tmp_path) as kept:
            past = tuple(study.finished_trials(kept))
        rungs = sorted(each.system_attrs["completed_rung_0"] for each in past)
        assert self.pruning("halving", past)(1, rungs[0])
        assert not self.pruning("halving", past)(1, rungs[-1] + 0.1)
        assert {each.state for each in past} == {TrialState.COMPLETE, TrialState.PRUNED}


class TestResuming:
    def test_several_workers_carry_out_all_trials(self, tmp_path) -> None:
        trials = searched(SMALL, tmp_path, workers=2)
        assert [each.number for each in trials] == list(range(14))
        assert {each.state for each in trials} == {TrialState.COMPLETE, TrialState.PRUNED}
        assert all(each.intermediate_values for each in trials)

    @pytest.mark.parametrize("at", [0, 5, 13])
    def test_interrupted_trials_run_once_more_and_finished_ones_do_not(self, at, tmp_path) -> None:
        before = searched(SMALL, tmp_path, partial(stopping, at))
        assert len(before) == at + 1
        trials = searched(SMALL, tmp_path)
        assert [each.params for each in trials[:at]] == [each.params for each in before[:at]]
        assert [each.datetime_complete for each in trials[:at]] == [
            each.datetime_complete for each in before[:at]
        ]
        assert trials[at].state == TrialState.FAIL
        assert trials[at + 1].params == trials[at].params == before[at].params
        with study.open_study(SMALL, tmp_path) as kept:
            assert len(study.finished_trials(kept)) == 14
        assert searched(SMALL, tmp_path) == trials  # nothing is left to do

    def test_a_killed_search_is_resumed(self, tmp_path) -> None:
        call = (
            "import sys; from pathlib import Path; from tests.agents.tuning.cheap import "
            "slow_search\nif __name__ == '__main__': slow_search(Path(sys.argv[1]))"
        )
        (tmp_path / "go.py").write_text(call)
        process = subprocess.Popen(
            [sys.executable, str(tmp_path / "go.py"), str(tmp_path)],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        url = f"sqlite:///{tmp_path / study.FILE}"
        found: list[FrozenTrial] = []
        while process.poll() is None and len(found) < 2:
            time.sleep(0.2)
            if (tmp_path / study.FILE).exists():
                found = look(url)
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL  # before it was done
        trials = searched(SMALL, tmp_path)
        for each in found:
            assert trials[each.number].value == each.value
        with study.open_study(SMALL, tmp_path) as kept:
            assert len(study.finished_trials(kept)) == 14


def look(url: str) -> list[FrozenTrial]:
    """Trials that have ended, by another connection."""
    storage = optuna.storages.RDBStorage(url, skip_table_creation=True)
    try:
        return study.finished_trials(optuna.load_study(study_name="search", storage=storage))
    except Exception:  # it is being made
        return []
    finally:
        storage.remove_session()
        storage.engine.dispose()


def stopping(
    at: int, sweep: Sweep, params: dict[str, Any], past: tuple[FrozenTrial, ...], report: Report
) -> TrialResult:
    if len(past) == at:
        raise KeyboardInterrupt
    return cheap_trial(sweep, params, past, report)


SWEEP = Sweep(
    task="slow", steps=30_000, evaluations=2, startup_trials=1, metric="return",
    space={"learning_rate": Span(1e-4, 1e-2), "n_steps": Choices([24, 32, 64])},
    fixed={"hidden": [8], "n_epochs": 1},
)  # fmt: skip
PARAMS = {"learning_rate": 1e-3, "n_steps": 32}


class TestTrial:
    """One trial: evaluations on the way, a judgement by fresh starts, and the ways it can end."""

    @pytest.fixture(autouse=True)
    def few_starts(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(study, "STARTS", 32)

    def run(self, sweep: Sweep = SWEEP, past: Any = (), **changed: Any) -> tuple[TrialResult, Any]:
        reported: list[tuple[int, float]] = []
        return study.run_trial(sweep, {**PARAMS, **changed}, past, reported.append), reported

    def test_it_is_complete_and_the_same_again(self) -> None:
        result, reported = self.run()
        assert (result.state, result.why) == (study.COMPLETE, "")
        assert result.value is not None
        assert np.isfinite(result.value)
        assert [number for number, _ in reported] == [1, 2]
        assert self.run() == (result, reported)

    def test_every_seed_is_evaluated_and_their_mean_counts(self) -> None:
        short = replace(SWEEP, steps=20_000, evaluations=1, seeds=2)
        both, reported = self.run(short)
        # `seed` chooses the starts they are judged on as well: only evaluations are compared.
        first, of_first = self.run(replace(short, seeds=1))
        _, of_second = self.run(replace(short, seeds=1, seed=1))
        assert reported == [of_first[0], (2, of_second[0][1])]
        assert both.value != first.value

    def test_below_the_median_it_ends(self) -> None:
        result, reported = self.run(past=(trial({1: 100.0, 2: 100.0}),))
        assert result == TrialResult(study.PRUNED)
        assert [number for number, _ in reported] == [1]

    def test_a_configuration_that_is_not_allowed_is_refused(self) -> None:
        result, reported = self.run(n_steps=25)
        assert (result.state, result.value, reported) == (study.REFUSED, None, [])
        assert "batch_size must be a factor" in result.why

    @pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers that grow too large
    def test_weights_that_are_not_finite_fail_the_trial_alone(self) -> None:
        result, _ = self.run(learning_rate=1e30)
        assert (result.state, result.value) == (study.FAILED, None)
        assert "invalid values" in result.why

    def test_an_interrupt_is_passed_on(self, monkeypatch) -> None:
        monkeypatch.setattr(study, "train", lambda *_: TrainResult(0, 0.0, True))
        with pytest.raises(KeyboardInterrupt):
            self.run()

    @pytest.mark.parametrize(
        ("algo", "task", "fixed"),
        [
            ("dqn", "slow", {"hidden": [8], "gradient_steps": 1, "batch_size": 32}),
            ("modules", "sort", {"hidden": [8], "n_epochs": 1}),
        ],
    )
    def test_other_algorithms(self, algo, task, fixed) -> None:
        sweep = Sweep(
            algo=algo, task=task, steps=20_000, evaluations=1,
            space={"gamma": Choices([0.9, 0.99])}, fixed=fixed,
        )  # fmt: skip
        reported: list[tuple[int, float]] = []
        result = study.run_trial(sweep, {"gamma": 0.9}, (), reported.append)
        assert result.state == study.COMPLETE
        assert result.value is not None
        assert 0.0 <= result.value <= 1.0
        assert [number for number, _ in reported] == [1]


class TestJudgement:
    sweep = replace(SWEEP, task="sort", metric="success", seed=5, fixed={"camera_share": 0.0})
    config = PPOConfig(steps=60_000, camera_share=0.0, hidden=(16,))

    @pytest.fixture(scope="class")
    @classmethod
    def folder(cls, tmp_path_factory: pytest.TempPathFactory) -> Path:
        folder = tmp_path_factory.mktemp("run")
        train(cls.config, folder)
        return folder

    def test_it_is_the_share_of_starts_that_succeed_whatever_was_learned_from(
        self, folder, monkeypatch
    ) -> None:
        monkeypatch.setattr(study, "STARTS", 100)
        env_config = make_card(self.config).env_config()
        alone = run_episodes(load_policy(folder), env_config, [{}] * 100, study.JUDGE_SEED + 5)
        judged = study.score_policy(self.config, self.sweep, folder)
        assert judged == alone.success.mean()
        assert 0.0 < judged < 1.0
        other = replace(self.config, camera_share=1.0, friction=0.9, num_envs=128, seed=9)
        assert study.score_policy(other, self.sweep, folder) == judged

    def test_nothing_is_learned_or_compared_on_these_starts(self) -> None:
        with pytest.raises(ValueError, match="between 0 and 2"):
            np.random.RandomState(study.JUDGE_SEED)  # what Stable-Baselines3 learns by
        assert SEED + DRAWN + study.STARTS < study.JUDGE_SEED
