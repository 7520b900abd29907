"""A study of Optuna, whose trials are run by workers and stored in study.db.

Only the command's process reads and writes the study. A worker gets a copy of the finished trials,
to prune its own trial. A trial trains for a short time with intermediate evaluations. Its final
score uses fresh starts that are equal for all trials.
"""

import math
import sqlite3
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.pruners import BasePruner, MedianPruner, NopPruner, SuccessiveHalvingPruner
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState
from optuna.visualization import matplotlib as plots
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from sqlalchemy.exc import SQLAlchemyError

from surface_gym.cli import TRAIN, command_line
from surface_gym.executors import Report
from surface_gym.files import ARCHIVE, DAMAGE, check_plain, describe_damage
from surface_gym.parallel import Workers, map_jobs

from ..evaluation.tables import markdown
from ..learning.config import ParcelConfig, config_of_seed, write_hyperparams
from ..learning.runs import StopTraining, read_curve, train
from ..learning.sb3 import make_training_envs
from ..library import find_task, read
from .sweep import SearchConfig

FILE = "study.db"  # SQLite, readable by optuna-dashboard
STARTS = 512  # number of starts for a policy's score
JUDGE_SEED = 2**32  # first seed of these starts; training uses lower seeds
COMPLETE, PRUNED = "complete", "pruned"
REFUSED = "refused"  # a configuration that is not allowed
FAILED = "failed"  # weights became not finite
REASON = "why"  # user attribute of a trial that was refused or failed
_STATES = {COMPLETE: TrialState.COMPLETE, PRUNED: TrialState.PRUNED}  # of others: FAIL


@dataclass(frozen=True)
class TrialResult:
    """Result of a trial."""

    state: str  # COMPLETE, PRUNED, REFUSED or FAILED
    value: float | None = None  # value of a complete trial
    why: str = ""  # reason of a refused or failed trial


# Function that runs a trial of a search, with its values and the finished trials.
RunTrial = Callable[[SearchConfig, dict[str, Any], tuple[FrozenTrial, ...], Report], TrialResult]


@contextmanager
def open_study(sweep: SearchConfig, folder: Path) -> Iterator[optuna.Study]:
    """Open the study of a search in its folder, or make it.

    Trials that were interrupted with an earlier process are repeated.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    file = folder / FILE
    with ExitStack() as opened:
        try:
            if file.exists():
                _check_file(file)
            storage = optuna.storages.RDBStorage(f"sqlite:///{file.resolve().as_posix()}")
            opened.callback(storage.engine.dispose)
            opened.callback(storage.remove_session)
            study = optuna.create_study(
                storage=storage, study_name="search", direction="maximize", load_if_exists=True
            )
            for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
                study.tell(trial.number, state=TrialState.FAIL)
                study.enqueue_trial(trial.params)
        except (sqlite3.Error, SQLAlchemyError, optuna.exceptions.OptunaError, *DAMAGE) as error:
            raise ValueError(f"{file} holds no search: {describe_damage(error)}") from None
        study.sampler = make_sampler(sweep, len(study.get_trials(deepcopy=False)))
        study.pruner = make_pruner(sweep)
        yield study


def _check_file(file: Path) -> None:
    check_plain(file, ARCHIVE)
    with closing(sqlite3.connect(file)) as tables:
        (found,) = tables.execute("PRAGMA quick_check(1)").fetchone()
    if found != "ok":
        raise ValueError(found)


def finished_trials(study: optuna.Study) -> list[FrozenTrial]:
    """Return the finished trials, without interrupted ones."""
    return [
        trial
        for trial in study.get_trials(deepcopy=False)
        if trial.state in _STATES.values() or REASON in trial.user_attrs
    ]


def best_trial(trials: list[FrozenTrial]) -> FrozenTrial | None:
    """Return the first complete trial with the highest value; None without complete trials."""
    complete = [trial for trial in trials if trial.state == TrialState.COMPLETE]
    return max(complete, key=lambda trial: (trial.value, -trial.number), default=None)


def describe_state(trial: FrozenTrial) -> str:
    """Return the state of a trial in words, with the reason if it was refused or has failed."""
    return str(trial.user_attrs.get(REASON, trial.state.name.lower()))


def optimize(
    sweep: SearchConfig, study: optuna.Study, workers: Workers, console: Console, run: "RunTrial"
) -> None:
    """Run the missing trials of a search, and store each result.

    Args:
        run: function that runs a trial; defined in a module, so that other processes find it.
    """
    done = finished_trials(study)
    asked: list[optuna.Trial] = []
    bars = Progress(
        TextColumn("{task.description}"), BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f}  {task.fields[note]}"),
        TimeElapsedColumn(), console=console,
    )  # fmt: skip
    total = bars.add_task("trials", total=sweep.trials, completed=len(done), note=_note(done))
    rows = []

    def jobs() -> Iterator[partial[TrialResult]]:
        for _ in range(sweep.trials - len(done)):
            trial = study.ask(dict(sorted(sweep.space.items())))
            asked.append(trial)
            rows.append(bars.add_task(f"trial {trial.number}", total=sweep.max_reports, note=""))
            past = tuple(study.get_trials(deepcopy=False, states=tuple(_STATES.values())))
            yield partial(run, sweep, sweep.plain_params(trial.params), past)

    def on_report(index: int, reported: tuple[int, float]) -> None:
        number, value = reported
        known = study.get_trials(deepcopy=False)[asked[index].number].intermediate_values
        if number not in known:  # else the trial's process died and it has begun again
            asked[index].report(value, number)
            asked[index].should_prune()  # notes the rung of successive halving; the worker decides
        bars.update(rows[index], completed=number, note=f"{sweep.metric} {value:.3f}")

    with bars:
        for index, result in map_jobs(jobs(), workers, on_report):
            trial = asked[index]
            if result.why:
                trial.set_user_attr(REASON, f"{result.state}: {result.why}")
            study.tell(trial, result.value, _STATES.get(result.state, TrialState.FAIL))
            done = finished_trials(study)
            bars.remove_task(rows[index])
            bars.update(total, completed=len(done), note=_note(done))


def run_trial(
    sweep: SearchConfig, params: dict[str, Any], past: tuple[FrozenTrial, ...], report: Report
) -> TrialResult:
    """Run a trial in its own folder.

    Args:
        report: callback with the number of each evaluation (from 1) and its value.
    """
    try:
        config = sweep.config(params)
    except ValueError as error:
        return TrialResult(REFUSED, why=str(error))
    prune = Pruning(sweep, past, report)
    try:
        values = [_train_and_score(sweep, config, k, prune) for k in range(sweep.seeds)]
    except optuna.TrialPruned:
        return TrialResult(PRUNED)
    except (ValueError, ArithmeticError) as error:  # of weights that are not finite
        return TrialResult(FAILED, why=" ".join(str(error).split())[:200])
    return TrialResult(COMPLETE, float(np.mean(values)))


class Pruning:
    """The pruner of a search, for one trial."""

    def __init__(self, sweep: SearchConfig, past: tuple[FrozenTrial, ...], report: Report) -> None:
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        sampler = RandomSampler(seed=0)  # without draws
        study = optuna.create_study(
            direction="maximize", sampler=sampler, pruner=make_pruner(sweep)
        )
        study.add_trials(past)
        self._trial, self._report = study.ask(), report

    def __call__(self, number: int, value: float) -> bool:
        """Report a value, and return whether the trial must end."""
        self._report((number, value))
        self._trial.report(value, number)
        return self._trial.should_prune()


def _train_and_score(
    sweep: SearchConfig, config: ParcelConfig, place: int, prune: Pruning
) -> float:
    """Train with one of the seeds, and score the policy."""
    run, pruned = config_of_seed(config, sweep.seed + place), False
    spacing = sweep.steps / (sweep.evaluations + 1)
    remaining = list(range(1, sweep.evaluations + 1))
    with TemporaryDirectory() as name:
        folder = Path(name)

        def on_progress(steps: int, _success: float) -> None:
            nonlocal pruned
            while remaining and steps >= remaining[0] * spacing:
                number = place * sweep.evaluations + remaining.pop(0)
                value = read_curve(folder)[-1][sweep.metric]
                if not np.isnan(value) and prune(number, value):  # nan: no episode has ended yet
                    pruned = True
                    raise StopTraining

        result = train(run, folder, on_progress)
        if pruned:
            raise optuna.TrialPruned
        if result.interrupted:
            raise KeyboardInterrupt
        return score_policy(run, sweep, folder)


def score_policy(config: ParcelConfig, sweep: SearchConfig, folder: Path) -> float:
    """Return the mean over the greedy policy's first episodes on fresh starts."""
    policy = read(folder, find_task(config.task))
    # All trials are judged with the same share of cameras and the same friction.
    usual: dict[str, Any] = {
        name: sweep.fixed.get(name, getattr(sweep.default, name))
        for name in ("camera_share", "friction")
    }
    usual |= {"num_envs": STARTS, "batch_size": STARTS}  # the configuration checks that these go
    env = make_training_envs(replace(config, **usual))
    env.seed(JUDGE_SEED + sweep.seed)
    observations = np.asarray(env.reset())
    values = np.full(STARTS, np.nan)
    while np.isnan(values).any():
        action, _ = policy.predict(observations, deterministic=True)
        stepped, _, dones, infos = env.step(action)
        observations = np.asarray(stepped)
        for i in np.nonzero(dones & np.isnan(values))[0]:
            info = infos[i]
            values[i] = info["is_success"] if sweep.metric == "success" else info["episode"]["r"]
    env.close()
    return float(values.mean())


def make_sampler(sweep: SearchConfig, asked: int) -> BaseSampler:
    """Make the sampler of a search.

    Args:
        asked: number of earlier trials. With the search's seed, it seeds the sampler.
    """
    seed = int(np.random.SeedSequence((sweep.seed, asked)).generate_state(1)[0])
    if sweep.sampler == "random":
        return RandomSampler(seed=seed)
    return TPESampler(seed=seed, n_startup_trials=sweep.startup_trials)


def make_pruner(sweep: SearchConfig) -> BasePruner:
    """Make the pruner of a search, like rl-baselines3-zoo."""
    if sweep.pruner == "median":
        return MedianPruner(sweep.startup_trials, n_warmup_steps=sweep.evaluations // 3)
    if sweep.pruner == "halving":
        return SuccessiveHalvingPruner(min_resource=1)
    return NopPruner()


def _note(trials: list[FrozenTrial]) -> str:
    best = best_trial(trials)
    return "" if best is None else f"best {best.value:.3f}, trial {best.number}"


PAGE = "report.md"
BEST = "best.yml"
BEST_SHARE = 0.25  # [-] of the complete trials, which importance tells from the others
MIN_COMPLETE = 8  # trials that importance needs


def write_report(sweep: SearchConfig, study: optuna.Study, folder: Path) -> None:
    """Write report.md, its plots, and best.yml, which `train.py --hyperparams` takes.

    There is no best.yml if no trial is complete, and no importance.png if too few are.
    """
    trials = finished_trials(study)
    best, shares = best_trial(trials), importance(sweep, study)
    finished = optuna.create_study(direction="maximize")
    finished.add_trials(trials)
    _save(plots.plot_optimization_history, folder / "history.png", finished)
    _save(plots.plot_intermediate_values, folder / "curves.png", finished)
    sections = [
        f"# Search of hyper-parameters: {sweep.task}, {sweep.algo}",
        _request(sweep, trials),
    ]
    if best is not None:
        # As long as the task is usually learned: few steps are for trials alone.
        params, usual = sweep.plain_params(best.params), sweep.default
        config = replace(sweep.config(params), steps=usual.steps, seed=usual.seed)
        write_hyperparams(config, folder / BEST)
        given = ("--task", sweep.task, "--algo", sweep.algo, "--hyperparams", BEST)
        sections += [
            f"## Best: trial {best.number}, {sweep.metric} {best.value:.4g}",
            markdown(["hyper-parameter", "value"], [[k, _text(v)] for k, v in params.items()]),
            f"`{command_line(TRAIN, *given)}` trains with it for {usual.steps:,} control periods, "
            "as long as the task is usually learned.",
        ]
    sections += ["![](history.png)\n\n![](curves.png)", "## Importance"]
    if shares is None:
        sections.append(
            f"It takes {MIN_COMPLETE} complete trials, the best quarter of them better than the "
            "others, to tell what is important."
        )
    else:
        evaluator = PedAnovaImportanceEvaluator(target_quantile=BEST_SHARE)
        options: dict[str, Any] = {"evaluator": evaluator, "params": sorted(shares)}
        _save(plots.plot_param_importances, folder / "importance.png", finished, **options)
        sections += [
            "How much each decides whether a complete trial is among the best quarter (PED-ANOVA). "
            "With so few trials it is a hint.",
            "![](importance.png)",
            markdown(
                ["hyper-parameter", "importance"],
                [[name, f"{100.0 * share:.0f} %"] for name, share in shares.items()],
            ),
        ]
    sections += ["## Trials", _trials(sweep, trials)]
    (folder / PAGE).write_text("\n\n".join(sections) + "\n")


def importance(sweep: SearchConfig, study: optuna.Study) -> dict[str, float] | None:
    """Compute the importance of each hyper-parameter for being in the best quarter of trials.

    Returns:
        Shares by PED-ANOVA that sum to 1, largest first. None with fewer than `MIN_COMPLETE`
        complete trials, or if equal values leave no best quarter.
    """
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    values = sorted((trial.value for trial in complete if trial.value is not None), reverse=True)
    few = len(values) < MIN_COMPLETE
    if few or values[math.ceil(BEST_SHARE * len(values)) - 1] == values[-1]:
        return None
    evaluator = PedAnovaImportanceEvaluator(target_quantile=BEST_SHARE)
    found = get_param_importances(study, evaluator=evaluator, params=sorted(sweep.space))
    return dict(sorted(found.items(), key=lambda each: (-each[1], each[0])))


def summary(sweep: SearchConfig, trials: Sequence[FrozenTrial]) -> str:
    """Count the trials by state and name the best, in a sentence."""
    counts = Counter(describe_state(trial).partition(":")[0] for trial in trials)
    states = ", ".join(f"{count} {state}" for state, count in sorted(counts.items()))
    best = best_trial(list(trials))
    if best is None:
        return f"{states}; none is complete, so none is best"
    return f"{states}; the best is trial {best.number}, {sweep.metric} {best.value:.4g}"


def _save(plot: Any, file: Path, study: optuna.Study, **options: Any) -> None:
    plt.switch_backend("agg")
    with warnings.catch_warnings(), plt.rc_context():  # Optuna sets a style for all of Matplotlib
        warnings.simplefilter("ignore")  # plots are experimental, and warn where they are empty
        figure = plot(study, **options).figure
        figure.savefig(file, dpi=150, bbox_inches="tight")
    plt.close(figure)


def _request(sweep: SearchConfig, trials: Sequence[FrozenTrial]) -> str:
    seeds = "" if sweep.seeds == 1 else f", mean over {sweep.seeds} seeds"
    return (
        f"{sweep.trials} trials of {sweep.steps:,} control periods; sampler: {sweep.sampler} (seed "
        f"{sweep.seed}), pruner: {sweep.pruner}. What counts is the {sweep.metric} of the greedy "
        f"policy on {STARTS} fresh starts{seeds}; on the way, that of the latest episodes. "
        f"{summary(sweep, trials)}."
    )


def _trials(sweep: SearchConfig, trials: Sequence[FrozenTrial]) -> str:
    rows = []
    for trial in trials:
        value = trial.value if trial.state == TrialState.COMPLETE else None
        latest = trial.intermediate_values.get(max(trial.intermediate_values, default=0))
        state = describe_state(trial).replace("|", "/")
        values = [_text(each) for each in sweep.plain_params(trial.params).values()]
        rows.append([str(trial.number), state, _text(value), _text(latest), *values])
    return markdown(
        ["trial", "state", sweep.metric, "latest on the way", *sorted(sweep.space)], rows
    )


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
