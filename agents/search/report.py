"""What a search has found: a page, pictures, and the best configuration."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..learning.hyperparams import write_hyperparams
from ..programs import TRAIN, typed
from .pictures import draw_curves, draw_history, draw_importance
from .study import FEWEST, importance
from .sweep import Sweep
from .trial import STARTS
from .tried import Tried, best_of

PAGE = "report.md"
BEST = "best.yml"


def write_report(sweep: Sweep, trials: Sequence[Tried], folder: Path) -> None:
    """Write the report of a search into its folder: report.md with history.png, curves.png and
    importance.png, and best.yml, which `train.py --hyperparams` takes.

    Where no trial is complete there is no best.yml; where there are too few, no importance.png.
    """
    best = best_of(trials)
    shares = importance(sweep, trials)
    draw_history(sweep, trials, folder / "history.png")
    draw_curves(sweep, trials, folder / "curves.png")
    if shares is not None:
        draw_importance(shares, folder / "importance.png")
    if best is not None:
        found = sweep.config(best.params)
        # As long as the task is usually learned: a trial's few steps are for the search alone.
        usual = replace(found, steps=sweep.default.steps, seed=sweep.default.seed)
        write_hyperparams(usual, folder / BEST)
    sections = [
        f"# Search of hyper-parameters: {sweep.task}, {sweep.algo}",
        _told(sweep, trials),
        *_of_the_best(sweep, best),
        "![](history.png)\n\n![](curves.png)",
        "## Importance",
        *_of_importance(shares),
        "## Trials",
        _table(sweep, trials),
    ]
    (folder / PAGE).write_text("\n\n".join(sections) + "\n")


def summary(sweep: Sweep, trials: Sequence[Tried]) -> str:
    """How many trials came to what, and the best of them, in a sentence."""
    counts = Counter(tried.state for tried in trials)
    states = ", ".join(f"{count} {state}" for state, count in sorted(counts.items()))
    best = best_of(trials)
    if best is None:
        return f"{states}; none is complete, so none is best"
    return f"{states}; the best is trial {best.number}, {sweep.metric} {best.value:.4g}"


def _told(sweep: Sweep, trials: Sequence[Tried]) -> str:
    seeds = "" if sweep.seeds == 1 else f", mean over {sweep.seeds} seeds"
    asker = {"tpe": "TPE asks", "random": "they are drawn at random"}[sweep.sampler]
    pruner = {
        "median": "the median prunes",
        "halving": "successive halving prunes",
        "none": "none is pruned",
    }[sweep.pruner]
    return (
        f"{sweep.trials} trials of {sweep.steps:,} control periods, in generations of "
        f"{sweep.generation}: {asker} (seed {sweep.seed}), {pruner}. What counts is the "
        f"{sweep.metric} of the greedy policy on {STARTS} fresh starts{seeds}; on the way, that of "
        f"the latest episodes. {summary(sweep, trials)}."
    )


def _of_the_best(sweep: Sweep, best: Tried | None) -> list[str]:
    if best is None:
        return []
    asked = ("--task", sweep.task, "--algo", sweep.algo, "--hyperparams", BEST)
    return [
        f"## Best: trial {best.number}, {sweep.metric} {best.value:.4g}",
        _rows(["hyper-parameter", "value"], [[name, _text(v)] for name, v in best.params.items()]),
        f"`{typed(TRAIN, *asked)}` learns by "
        f"it for {sweep.default.steps:,} control periods, as long as the task is usually learned.",
    ]


def _of_importance(shares: Mapping[str, float] | None) -> list[str]:
    if shares is None:
        return [
            f"It takes {FEWEST} complete trials, the best quarter of them better than the others, "
            "to tell what is important."
        ]
    rows = [[name, f"{100.0 * share:.0f} %"] for name, share in shares.items()]
    return [
        "How much each decides whether a complete trial is among the best quarter (PED-ANOVA). "
        "With so few trials it is a hint.",
        "![](importance.png)",
        _rows(["hyper-parameter", "importance"], rows),
    ]


def _table(sweep: Sweep, trials: Sequence[Tried]) -> str:
    names = sorted(sweep.space)
    rows = []
    for tried in trials:
        latest = tried.intermediate[max(tried.intermediate)] if tried.intermediate else None
        state = f"{tried.state}: {tried.why.replace('|', '/')}" if tried.why else tried.state
        values = [_text(tried.params[name]) for name in names]
        rows.append([str(tried.number), state, _text(tried.value), _text(latest), *values])
    return _rows(["trial", "state", sweep.metric, "latest on the way", *names], rows)


def _rows(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
