"""The report of a search: a page, plots, and the best configuration."""

import math
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.trial import FrozenTrial, TrialState
from optuna.visualization import matplotlib as plots

from ..base import TRAIN, command_line
from ..learning.hyperparams import write_hyperparams
from .study import STARTS, best_trial, finished_trials, plain_params, state_of
from .sweep import Sweep

PAGE = "report.md"
BEST = "best.yml"
BEST_SHARE = 0.25  # [-] of the complete trials, which importance tells from the others
MIN_COMPLETE = 8  # trials that importance needs


def write_report(sweep: Sweep, study: optuna.Study, folder: Path) -> None:
    """Write report.md, its plots, and best.yml, which `train.py --hyperparams` takes.

    There is no best.yml if no trial is complete, and no importance.png if too few are.
    """
    trials = finished_trials(study)
    best, shares = best_trial(trials), importance(sweep, study)
    of_ended = optuna.create_study(direction="maximize")  # without those that were interrupted
    of_ended.add_trials(trials)
    _save(plots.plot_optimization_history, folder / "history.png", of_ended)
    _save(plots.plot_intermediate_values, folder / "curves.png", of_ended)
    if shares is not None:
        evaluator, names = PedAnovaImportanceEvaluator(target_quantile=BEST_SHARE), sorted(shares)
        file = folder / "importance.png"
        _save(plots.plot_param_importances, file, of_ended, evaluator=evaluator, params=names)
    if best is not None:
        config = sweep.config(plain_params(sweep, best))
        # As long as the task is usually learned: few steps are for trials alone.
        usual = replace(config, steps=sweep.default.steps, seed=sweep.default.seed)
        write_hyperparams(usual, folder / BEST)
    sections = [
        f"# Search of hyper-parameters: {sweep.task}, {sweep.algo}",
        _request(sweep, trials),
        *_best(sweep, best),
        "![](history.png)\n\n![](curves.png)",
        "## Importance",
        *_importance(shares),
        "## Trials",
        _trials(sweep, trials),
    ]
    (folder / PAGE).write_text("\n\n".join(sections) + "\n")


def importance(sweep: Sweep, study: optuna.Study) -> dict[str, float] | None:
    """Compute how much each hyper-parameter decides whether a trial is among the best quarter.

    Returns:
        Shares by PED-ANOVA, which sum up to 1, the largest first; None if the complete trials are
        fewer than `MIN_COMPLETE`, or too many are equally good to tell a best quarter.
    """
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    values = sorted((trial.value for trial in complete if trial.value is not None), reverse=True)
    few = len(values) < MIN_COMPLETE
    if few or values[math.ceil(BEST_SHARE * len(values)) - 1] == values[-1]:
        return None
    evaluator = PedAnovaImportanceEvaluator(target_quantile=BEST_SHARE)
    found = get_param_importances(study, evaluator=evaluator, params=sorted(sweep.space))
    return dict(sorted(found.items(), key=lambda each: (-each[1], each[0])))


def summary(sweep: Sweep, trials: Sequence[FrozenTrial]) -> str:
    """Count the trials by state and name the best, in a sentence."""
    counts = Counter(state_of(trial).partition(":")[0] for trial in trials)
    states = ", ".join(f"{count} {state}" for state, count in sorted(counts.items()))
    best = best_trial(list(trials))
    if best is None:
        return f"{states}; none is complete, so none is best"
    return f"{states}; the best is trial {best.number}, {sweep.metric} {best.value:.4g}"


def _save(plot: Any, file: Path, study: optuna.Study, **options: Any) -> None:
    plt.switch_backend("agg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # plots are experimental, and warn where they are empty
        figure = plot(study, **options).figure
    figure.savefig(file, dpi=150, bbox_inches="tight")
    plt.close(figure)


def _request(sweep: Sweep, trials: Sequence[FrozenTrial]) -> str:
    seeds = "" if sweep.seeds == 1 else f", mean over {sweep.seeds} seeds"
    return (
        f"{sweep.trials} trials of {sweep.steps:,} control periods; sampler: {sweep.sampler} (seed "
        f"{sweep.seed}), pruner: {sweep.pruner}. What counts is the {sweep.metric} of the greedy "
        f"policy on {STARTS} fresh starts{seeds}; on the way, that of the latest episodes. "
        f"{summary(sweep, trials)}."
    )


def _best(sweep: Sweep, best: FrozenTrial | None) -> list[str]:
    if best is None:
        return []
    command = command_line(TRAIN, "--task", sweep.task, "--algo", sweep.algo, "--hyperparams", BEST)
    params = plain_params(sweep, best)
    return [
        f"## Best: trial {best.number}, {sweep.metric} {best.value:.4g}",
        _table(["hyper-parameter", "value"], [[name, _text(v)] for name, v in params.items()]),
        f"`{command}` trains with it for {sweep.default.steps:,} control periods, as long as the "
        "task is usually learned.",
    ]


def _importance(shares: dict[str, float] | None) -> list[str]:
    if shares is None:
        return [
            f"It takes {MIN_COMPLETE} complete trials, the best quarter of them better than the "
            "others, to tell what is important."
        ]
    return [
        "How much each decides whether a complete trial is among the best quarter (PED-ANOVA). "
        "With so few trials it is a hint.",
        "![](importance.png)",
        _table(
            ["hyper-parameter", "importance"],
            [[name, f"{100.0 * share:.0f} %"] for name, share in shares.items()],
        ),
    ]


def _trials(sweep: Sweep, trials: Sequence[FrozenTrial]) -> str:
    rows = []
    for trial in trials:
        value = trial.value if trial.state == TrialState.COMPLETE else None
        latest = trial.intermediate_values.get(max(trial.intermediate_values, default=0))
        state = state_of(trial).replace("|", "/")
        values = [_text(each) for each in plain_params(sweep, trial).values()]
        rows.append([str(trial.number), state, _text(value), _text(latest), *values])
    return _table(["trial", "state", sweep.metric, "latest on the way", *sorted(sweep.space)], rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
