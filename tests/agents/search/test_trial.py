"""One trial: looks on the way, a judgement by fresh starts, and the ways it can end."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.episodes import run_episodes
from agents.evaluation.trials import DRAWN, SEED
from agents.learning.config import PPOConfig, card_of
from agents.learning.legs import Learned
from agents.learning.training import train
from agents.policies.files import load_policy
from agents.search import trial
from agents.search.study import Order
from agents.search.sweep import Choices, Span, Sweep
from agents.search.trial import JUDGED, STARTS, judge, run_trial
from agents.search.tried import COMPLETE, FAILED, PRUNED, REFUSED, Tried

SPACE = {"learning_rate": Span(1e-4, 1e-2), "n_steps": Choices([24, 32, 64])}
TINY: dict[str, Any] = {"hidden": [8], "n_epochs": 1}
SWEEP = Sweep(
    task="slow", steps=30_000, evaluations=2, startup_trials=1, metric="return", space=SPACE,
    fixed=TINY,
)  # fmt: skip
PARAMS = {"learning_rate": 1e-3, "n_steps": 32}


@pytest.fixture(autouse=True)
def few_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "STARTS", 32)


def carried_out(order: Order) -> tuple[Tried, list[tuple[int, float]]]:
    told: list[tuple[int, float]] = []
    return run_trial(order, told.append), told


def test_a_trial_is_complete_and_the_same_again() -> None:
    tried, told = carried_out(Order(SWEEP, 7, PARAMS, ()))
    assert (tried.number, tried.params, tried.state, tried.why) == (7, PARAMS, COMPLETE, "")
    assert tried.value is not None
    assert np.isfinite(tried.value)
    assert list(tried.intermediate.items()) == told
    assert [look for look, _ in told] == [1, 2]
    again, _ = carried_out(Order(SWEEP, 7, PARAMS, ()))
    assert replace(again, seconds=tried.seconds) == tried


def test_every_seed_has_its_looks_and_their_mean_counts() -> None:
    short = replace(SWEEP, steps=20_000, evaluations=1, seeds=2)
    both, told = carried_out(Order(short, 0, PARAMS, ()))
    assert [look for look, _ in told] == [1, 2]
    # `seed` chooses the starts they are judged on as well: each alone is looked at on the way.
    first, _ = carried_out(Order(replace(short, seeds=1), 0, PARAMS, ()))
    second, _ = carried_out(Order(replace(short, seeds=1, seed=1), 0, PARAMS, ()))
    assert both.intermediate == {1: first.intermediate[1], 2: second.intermediate[1]}
    assert both.value != first.value


def test_below_the_median_it_ends() -> None:
    good = Tried(0, PARAMS, COMPLETE, 100.0, {1: 100.0, 2: 100.0}, {}, "", 0.0)
    tried, told = carried_out(Order(SWEEP, 4, PARAMS, (good,)))
    assert (tried.state, tried.value) == (PRUNED, None)
    assert [look for look, _ in told] == [1]


def test_a_configuration_that_is_not_allowed_is_told_of() -> None:
    tried, told = carried_out(Order(SWEEP, 1, {**PARAMS, "n_steps": 25}, ()))
    assert (tried.state, tried.value, tried.intermediate, told) == (REFUSED, None, {}, [])
    assert "batch_size must be a factor" in tried.why


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers that grow too large
def test_weights_that_are_no_numbers_fail_the_trial_alone() -> None:
    tried, _ = carried_out(Order(SWEEP, 1, {**PARAMS, "learning_rate": 1e30}, ()))
    assert (tried.state, tried.value) == (FAILED, None)
    assert "invalid values" in tried.why


def test_an_interrupt_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "start", lambda *_: Learned(0, 0.0, True))
    with pytest.raises(KeyboardInterrupt):
        carried_out(Order(SWEEP, 0, PARAMS, ()))


@pytest.mark.parametrize(
    ("algo", "task", "fixed"),
    [
        ("dqn", "slow", {"hidden": [8], "gradient_steps": 1, "batch_size": 32}),
        ("modules", "sort", TINY),
    ],
)
def test_other_algorithms(algo: str, task: str, fixed: dict[str, Any]) -> None:
    sweep = Sweep(
        algo=algo, task=task, steps=20_000, evaluations=1,
        space={"gamma": Choices([0.9, 0.99])}, fixed=fixed,
    )  # fmt: skip
    tried, told = carried_out(Order(sweep, 0, {"gamma": 0.9}, ()))
    assert tried.state == COMPLETE
    assert tried.value is not None
    assert 0.0 <= tried.value <= 1.0
    assert [look for look, _ in told] == [1]


class TestJudgement:
    sweep = replace(SWEEP, task="sort", metric="success", seed=5, fixed={"camera_share": 0.0})
    config = PPOConfig(steps=60_000, camera_share=0.0, hidden=(16,))

    @pytest.fixture(scope="class")
    @classmethod
    def folder(cls, tmp_path_factory: pytest.TempPathFactory) -> Path:
        folder = tmp_path_factory.mktemp("run")
        train(cls.config, folder)
        return folder

    def test_it_is_the_share_of_starts_that_succeed(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(trial, "STARTS", 100)
        settings = card_of(self.config).settings()
        alone = run_episodes(load_policy(folder), settings, [{}] * 100, JUDGED + 5)
        assert judge(self.config, self.sweep, folder) == alone.success.mean()
        assert 0.0 < alone.success.mean() < 1.0

    def test_the_starts_are_the_same_whatever_was_learned_from(self, folder: Path) -> None:
        judged = judge(self.config, self.sweep, folder)
        other = replace(self.config, camera_share=1.0, friction=0.9, lanes=128, seed=9)
        assert judge(other, self.sweep, folder) == judged

    def test_nobody_learns_on_them_and_nothing_is_compared_on_them(self) -> None:
        with pytest.raises(ValueError, match="between 0 and 2"):
            np.random.RandomState(JUDGED)  # what Stable-Baselines3 learns by
        assert SEED + DRAWN + STARTS < JUDGED
