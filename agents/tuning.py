"""Search of hyper-parameters: a study of Optuna, whose trials are run by workers.

A YAML file describes the search. Only the command's process reads and writes the study, which is
stored in study.db. A trial trains for a short time with intermediate evaluations. A worker compares
its trial with a copy of the finished trials, and may end it early (pruning). The value of a trial
is the policy's result on starts that training does not use. All trials have the same starts.
"""

import json
import sqlite3
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import optuna
from optuna import distributions as ranges
from optuna.pruners import MedianPruner
from optuna.samplers import RandomSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState
from optuna.visualization import matplotlib as plots
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from sqlalchemy.exc import SQLAlchemyError

from surface_gym import checks
from surface_gym.cli import TRAIN, command_line
from surface_gym.executors import Report
from surface_gym.files import ARCHIVE, DAMAGE, check_plain, describe_damage, replacing
from surface_gym.parallel import Workers, check_workers, map_jobs
from surface_gym.registration import DEFAULT_TASK, TASKS

from .evaluation.tables import markdown
from .learning.config import SWEEP, ParcelConfig, defaults, write_hyperparams
from .learning.runs import CURVE_EVERY, StopTraining, read_curve, train
from .learning.sb3 import make_training_envs
from .library import ALGORITHMS, find_task, read, read_yaml

STUDY, PAGE, BEST = "study.db", "report.md", "best.yml"  # files of a search
METRICS = ("success", "return")
OF_THE_SEARCH = ("task", "algo", "device", "seed", "seeds", "steps", "out", "name")
ROLLOUT = ("num_envs", "n_steps", "batch_size")  # options that must suit each other
STARTS = 512  # number of starts for a policy's value
JUDGE_SEED = 2**32  # first seed of these starts; training uses lower seeds
REASON = "why"  # user attribute of a trial that was refused or failed
VALUED = (TrialState.COMPLETE, TrialState.PRUNED)  # states of trials with values


@dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """Configuration of a search. `space` has ranges of options; `fixed` has options' values."""

    task: str = DEFAULT_TASK
    algo: str = "ppo"
    trials: int = 20
    steps: int = 200_000  # control periods per trial
    evaluations: int = 5  # evaluations per trial, at which it may be pruned
    seed: int = 0  # seed of the sampler and of the trials
    metric: str = "success"  # or the return
    startup_trials: int = 8  # random trials before the sampler and the pruner start
    space: dict[str, ranges.BaseDistribution] = field(default_factory=dict)
    # values that differ from the task's defaults
    fixed: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        of_one = [
            name for name, each in ALGORITHMS.items() if issubclass(each.config, ParcelConfig)
        ]
        checks.one_of("algo", self.algo, of_one)
        checks.one_of("metric", self.metric, METRICS)
        for name, least in (("trials", 1), ("evaluations", 1), ("seed", 0), ("startup_trials", 0)):
            checks.integer(name, getattr(self, name), least)
        least = (self.evaluations + 1) * CURVE_EVERY  # each evaluation has a row of the curve
        checks.integer(f"steps, with {self.evaluations} evaluations,", self.steps, least)
        if not self.space:
            raise ValueError("space must name what to search, got nothing")
        known = [each.name for each in fields(self.default) if each.name not in OF_THE_SEARCH]
        for where, named in (("space", self.space), ("fixed", self.fixed)):
            for name in named:
                checks.one_of(f"a name in {where}", name, known)
        if both := sorted(self.space.keys() & self.fixed.keys()):
            raise ValueError(f"fixed must name nothing that space does, got {', '.join(both)}")
        # The batch must suit the rollout. If one of both is drawn, only a trial checks this.
        any_batch = {"batch_size": 1} if any(name in self.space for name in ROLLOUT) else {}
        self._try("fixed", any_batch)
        for name, values in self.space.items():
            for value in _extremes(values):
                if name == "batch_size":
                    checks.integer("space: batch_size", value, least=1)
                else:
                    self._try("space", {name: value, **any_batch})

    @cached_property
    def default(self) -> ParcelConfig:
        """The package's default configuration of the task and the algorithm."""
        found = defaults(self.task, self.algo)
        assert isinstance(found, ParcelConfig)
        return found

    def config(self, params: Mapping[str, Any]) -> ParcelConfig:
        """Return the configuration of a trial with the drawn values."""
        chosen: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in {**self.fixed, **params}.items()
        }
        return replace(self.default, **chosen, steps=self.steps, seed=self.seed, seeds=1)

    def plain_params(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Convert values drawn by Optuna to values of a configuration."""
        return {
            name: json.loads(drawn[name])
            if isinstance(values, ranges.CategoricalDistribution)
            else drawn[name]
            for name, values in sorted(self.space.items())
        }

    def pruner(self) -> MedianPruner:
        """Make the same pruner as rl-baselines3-zoo."""
        return MedianPruner(self.startup_trials, n_warmup_steps=self.evaluations // 3)

    def _try(self, where: str, params: Mapping[str, Any]) -> None:
        try:
            self.config(params)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{where}: {error}") from None


def _extremes(values: ranges.BaseDistribution) -> list[Any]:
    if isinstance(values, ranges.CategoricalDistribution):
        return [json.loads(str(each)) for each in values.choices]
    assert isinstance(values, ranges.IntDistribution | ranges.FloatDistribution)
    return [values.low, values.high]


def read_sweep(file: Path, task: str | None = None) -> SearchConfig:
    """Read the configuration of a search; raise a ValueError if the file is invalid.

    The file must name a task of the package, or the custom `task`.
    """
    try:
        return _read(read_yaml(file, by_hand=True), task)
    except DAMAGE as error:
        raise ValueError(f"{file} is not a search's: {describe_damage(error)}") from None


def _read(plain: dict[str, Any], task: str | None) -> SearchConfig:
    known = [each.name for each in fields(SearchConfig)]
    for name in plain:
        checks.one_of("a name", name, known)
    named = plain.get("task", SearchConfig.task)
    if named != task and not (task is None and named in TASKS):
        raise ValueError(
            f"task must be one of {', '.join(TASKS)}, or a custom one that --task names too, "
            f"got {named!r}"
        )
    for name in ("space", "fixed"):
        if not isinstance(plain.get(name, {}), dict):
            raise ValueError(f"{name} must hold names and values, got {plain[name]!r}")
    space = {name: _distribution(name, values) for name, values in plain.get("space", {}).items()}
    return SearchConfig(**{**plain, "space": space})


def make_choices(choices: Sequence[Any]) -> ranges.CategoricalDistribution:
    """Make a distribution of values. The values become JSON texts, since Optuna takes no lists."""
    try:
        texts = [json.dumps(each) for each in choices] if isinstance(choices, list) else []
    except TypeError:
        texts = []
    if len(set(texts)) < max(2, len(texts)):
        raise ValueError(
            f"choices must be a list of two or more different plain values, got {choices!r}"
        )
    return ranges.CategoricalDistribution(texts)


def _distribution(name: str, values: Any) -> ranges.BaseDistribution:
    """Make Optuna's distribution of the option `name` from its limits or choices, `values`."""
    given = set(values) if isinstance(values, dict) else set()
    try:
        if given == {"choices"}:
            return make_choices(**values)
        if {"low", "high"} <= given <= {"low", "high", "log"}:
            for end in ("low", "high"):
                checks.number(end, values[end])
            checks.one_of("log", values.get("log", False), (True, False))
            whole = isinstance(values["low"], int) and isinstance(values["high"], int)
            return ranges.IntDistribution(**values) if whole else ranges.FloatDistribution(**values)
        raise ValueError(f"must be {{low, high, log}} or {{choices}}, got {values!r}")
    except ValueError as error:
        raise ValueError(f"space: {name}: {error}") from None


@dataclass(frozen=True)
class TrialResult:
    """Result of a trial."""

    state: TrialState  # FAIL: refused, or failed
    value: float | None = None  # value of a complete trial
    why: str = ""  # reason of a refused or failed trial


# Function that runs a trial of a search, with its values and the finished trials.
RunTrial = Callable[[SearchConfig, dict[str, Any], tuple[FrozenTrial, ...], Report], TrialResult]


def search(
    file: Path, folder: Path, workers: Workers, console: Console, task: str | None = None
) -> None:
    """Search hyper-parameters as a file says, or resume the search in a folder; write a report."""
    check_workers(workers)
    sweep = read_sweep(file, task)
    if file != folder / SWEEP:
        with replacing(folder / SWEEP) as part:
            part.write_bytes(file.read_bytes())
    with open_study(sweep, folder) as study:
        try:
            optimize(sweep, study, workers, console, run_trial)
        except KeyboardInterrupt:
            console.print(
                f"interrupted: {folder} holds {len(finished_trials(study))} trials; "
                f"{command_line(TRAIN, '--resume', str(folder))} resumes it",
                soft_wrap=True,
            )
            return
        write_report(sweep, study, folder)
        trials = finished_trials(study)
    console.print(summary(sweep, trials))
    best = "" if best_trial(trials) is None else f" and {BEST}"
    console.print(f"{folder} holds {PAGE}{best}", soft_wrap=True)


@contextmanager
def open_study(sweep: SearchConfig, folder: Path) -> Iterator[optuna.Study]:
    """Open the study in a folder. If no study exists, make a study. Repeat interrupted trials."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    file = folder / STUDY
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
        # A resumed search draws on, so the number of earlier trials is part of the seed.
        entropy = (sweep.seed, len(study.get_trials(deepcopy=False)))
        seed = int(np.random.SeedSequence(entropy).generate_state(1)[0])
        study.sampler = TPESampler(seed=seed, n_startup_trials=sweep.startup_trials)
        study.pruner = sweep.pruner()
        yield study


def _check_file(file: Path) -> None:
    check_plain(file, ARCHIVE)
    with closing(sqlite3.connect(file)) as tables:
        (found,) = tables.execute("PRAGMA quick_check(1)").fetchone()
    if found != "ok":
        raise ValueError(found)


def finished_trials(study: optuna.Study) -> list[FrozenTrial]:
    """Return a study's trials that were not interrupted."""
    trials = study.get_trials(deepcopy=False)
    return [trial for trial in trials if trial.state in VALUED or REASON in trial.user_attrs]


def best_trial(trials: Sequence[FrozenTrial]) -> FrozenTrial | None:
    """Return the first complete trial with the highest value, or None if no trial is complete."""
    complete = [trial for trial in trials if trial.state == TrialState.COMPLETE]
    return max(complete, key=lambda trial: (trial.value, -trial.number), default=None)


def describe_state(trial: FrozenTrial) -> str:
    """Return a trial's state; for a refused or failed trial, return the reason."""
    return str(trial.user_attrs.get(REASON, trial.state.name.lower()))


def optimize(
    sweep: SearchConfig, study: optuna.Study, workers: Workers, console: Console, run: RunTrial
) -> None:
    """Run the trials that `study` still lacks on `workers`, and store the results in `study`.

    The function `run` runs a trial. Other processes must be able to import this function.
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
            rows.append(bars.add_task(f"trial {trial.number}", total=sweep.evaluations, note=""))
            past = tuple(study.get_trials(deepcopy=False, states=VALUED))
            yield partial(run, sweep, sweep.plain_params(trial.params), past)

    def on_report(index: int, reported: tuple[int, float]) -> None:
        number, value = reported
        known = study.get_trials(deepcopy=False)[asked[index].number].intermediate_values
        if number not in known:  # else the trial's process died and it has begun again
            asked[index].report(value, number)
        bars.update(rows[index], completed=number, note=f"{sweep.metric} {value:.3f}")

    with bars:
        for index, result in map_jobs(jobs(), workers, on_report):
            trial = asked[index]
            if result.why:
                trial.set_user_attr(REASON, result.why)
            study.tell(trial, result.value, result.state)
            done = finished_trials(study)
            bars.remove_task(rows[index])
            bars.update(total, completed=len(done), note=_note(done))


def _note(trials: list[FrozenTrial]) -> str:
    best = best_trial(trials)
    return "" if best is None else f"best {best.value:.3f}, trial {best.number}"


def run_trial(
    sweep: SearchConfig, params: dict[str, Any], past: tuple[FrozenTrial, ...], report: Report
) -> TrialResult:
    """Train and score a policy with a trial's parameters.

    The search's pruner compares the trial with `past` trials. `report` is called with (number,
    value) after each evaluation; the first evaluation has the number 1.
    """
    try:
        config = sweep.config(params)
    except ValueError as error:
        return TrialResult(TrialState.FAIL, why=f"refused: {error}")
    try:
        return TrialResult(
            TrialState.COMPLETE, _train_and_score(sweep, config, Pruning(sweep, past, report))
        )
    except optuna.TrialPruned:
        return TrialResult(TrialState.PRUNED)
    except (ValueError, ArithmeticError) as error:  # of weights that are not finite
        return TrialResult(TrialState.FAIL, why=f"failed: {' '.join(str(error).split())[:200]}")


class Pruning:
    """Asks the search's pruner whether one trial must end early."""

    def __init__(self, sweep: SearchConfig, past: tuple[FrozenTrial, ...], report: Report) -> None:
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        sampler = RandomSampler(seed=0)  # without draws
        study = optuna.create_study(direction="maximize", sampler=sampler, pruner=sweep.pruner())
        study.add_trials(past)
        self._trial, self._report = study.ask(), report

    def __call__(self, number: int, value: float) -> bool:
        """Report the value of an evaluation, and return whether the trial must end."""
        self._report((number, value))
        self._trial.report(value, number)
        return self._trial.should_prune()


def _train_and_score(sweep: SearchConfig, config: ParcelConfig, prune: Pruning) -> float:
    """Train a policy, and return its score on fresh starts; `prune` may end the training."""
    pruned = False
    spacing = sweep.steps / (sweep.evaluations + 1)
    remaining = list(range(1, sweep.evaluations + 1))
    with TemporaryDirectory() as name:
        folder = Path(name)

        def on_progress(steps: int, _success: float) -> None:
            nonlocal pruned
            while remaining and steps >= remaining[0] * spacing:
                number, value = remaining.pop(0), read_curve(folder)[-1][sweep.metric]
                if not np.isnan(value) and prune(number, value):  # nan: no episode has ended yet
                    pruned = True
                    raise StopTraining

        result = train(config, folder, on_progress)
        if pruned:
            raise optuna.TrialPruned
        if result.interrupted:
            raise KeyboardInterrupt
        return score_policy(config, sweep, folder)


def score_policy(config: ParcelConfig, sweep: SearchConfig, folder: Path) -> float:
    """Run the policy in a folder from `STARTS` starts. Return the mean of the search's metric."""
    policy = read(folder, find_task(config.task))
    # All trials are judged with the same share of cameras and the same friction.
    usual: dict[str, Any] = {
        name: sweep.fixed.get(name, getattr(sweep.default, name))
        for name in ("camera_share", "friction")
    }
    usual |= {"num_envs": STARTS, "batch_size": STARTS}  # options that suit each other
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


def write_report(sweep: SearchConfig, study: optuna.Study, folder: Path) -> None:
    """Write report.md, plots and, if a trial is complete, best.yml for `train.py --hyperparams`."""
    trials = finished_trials(study)
    best = best_trial(trials)
    finished = optuna.create_study(direction="maximize")
    finished.add_trials(trials)
    _save(plots.plot_optimization_history, folder / "history.png", finished)
    _save(plots.plot_intermediate_values, folder / "curves.png", finished)
    sections = [
        f"# Search of hyper-parameters: {sweep.task}, {sweep.algo}",
        f"{sweep.trials} trials of {sweep.steps:,} control periods (seed {sweep.seed}). What "
        f"counts is the {sweep.metric} of the greedy policy on {STARTS} fresh starts; on the way, "
        f"the {sweep.metric} of the latest episodes. {summary(sweep, trials)}.",
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
    rows = []
    for trial in trials:
        value = trial.value if trial.state == TrialState.COMPLETE else None
        latest = trial.intermediate_values.get(max(trial.intermediate_values, default=0))
        drawn = sweep.plain_params(trial.params).values()
        state = describe_state(trial).replace("|", "/")
        rows.append([str(trial.number), state, *map(_text, (value, latest, *drawn))])
    titles = ["trial", "state", sweep.metric, "latest on the way", *sorted(sweep.space)]
    sections += ["![](history.png)\n\n![](curves.png)", "## Trials", markdown(titles, rows)]
    (folder / PAGE).write_text("\n\n".join(sections) + "\n")


def summary(sweep: SearchConfig, trials: Sequence[FrozenTrial]) -> str:
    """Return a sentence with the number of trials in each state, and with the best trial."""
    counts = Counter(describe_state(trial).partition(":")[0] for trial in trials)
    states = ", ".join(f"{count} {state}" for state, count in sorted(counts.items()))
    best = best_trial(trials)
    if best is None:
        return f"{states}; none is complete, so none is best"
    return f"{states}; the best is trial {best.number}, {sweep.metric} {best.value:.4g}"


def _save(plot: Any, file: Path, study: optuna.Study) -> None:
    plt.switch_backend("agg")
    with warnings.catch_warnings(), plt.rc_context():  # Optuna sets a style for all of Matplotlib
        warnings.simplefilter("ignore")  # plots are experimental, and warn where they are empty
        figure = plot(study).figure
        figure.savefig(file, dpi=150, bbox_inches="tight")
    plt.close(figure)


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
