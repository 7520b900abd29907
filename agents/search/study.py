"""Optuna: what it asks for, what it prunes, and how much each hyper-parameter matters.

Trials go in generations: all of one are asked for before any of it is told of, and what is pruned
goes by generations that are over. So neither depends on who was first done, where.
"""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.pruners import BasePruner, MedianPruner, NopPruner, SuccessiveHalvingPruner
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState

from .sweep import Choices, Span, Sweep
from .tried import COMPLETE, FAILED, PRUNED, REFUSED, Tried

_STATES = {
    COMPLETE: TrialState.COMPLETE,
    PRUNED: TrialState.PRUNED,
    REFUSED: TrialState.FAIL,
    FAILED: TrialState.FAIL,
}
BEST = 0.25  # [-] of the complete trials, that importance tells from the others
FEWEST = 8  # complete trials that tell what is important


@dataclass(frozen=True)
class Order:
    """A trial to carry out."""

    sweep: Sweep
    number: int
    params: dict[str, Any]  # value of each name in the space, as JSON has it
    past: tuple[Tried, ...]  # trials of earlier generations, by which it may be pruned


def carry_out(
    sweep: Sweep,
    kept: Mapping[int, Tried],
    work: Callable[[Sequence[Order]], Iterable[Tried]],
) -> list[Tried]:
    """Carry a search out, generation by generation.

    Args:
        sweep: that it is of.
        kept: trials that need not be carried out again, by number.
        work: carries out the trials of a generation that are not kept, and gives them in any order.

    Returns:
        All trials, by number.

    Raises:
        ValueError: a trial that is kept is not what this search asks for.
    """
    past: list[Tried] = []
    while len(past) < sweep.trials:
        orders = _asked(sweep, tuple(past))
        done = {order.number: kept[order.number] for order in orders if order.number in kept}
        for order in orders:
            if order.number in done and done[order.number].params != order.params:
                raise ValueError(
                    f"trial {order.number} must be of {order.params}, which the search asks for, "
                    f"got {done[order.number].params}: it was kept by another version"
                )
        left = [order for order in orders if order.number not in done]
        if left:
            done |= {tried.number: tried for tried in work(left)}
        past += [done[order.number] for order in orders]
    return past


class Watch:
    """Says whether to go on with a trial.

    Args:
        order: the trial.
    """

    def __init__(self, order: Order) -> None:
        self._study = _study(order.sweep, order.past, RandomSampler(seed=0), _pruner(order.sweep))
        self._trial = self._study.ask()

    def prunes(self, look: int, value: float) -> bool:
        """Whether a trial is to end that has come to a value at a look."""
        self._trial.report(value, look)
        return self._trial.should_prune()

    @property
    def rungs(self) -> dict[str, float]:
        """What the pruner has noted of it, for those who come after."""
        return dict(self._study.get_trials(deepcopy=False)[-1].system_attrs)


def importance(sweep: Sweep, trials: Sequence[Tried]) -> dict[str, float] | None:
    """How much each hyper-parameter decides whether a trial is among the best quarter: PED-ANOVA.

    Returns:
        Shares that sum up to 1, the largest first; None where the complete trials are fewer than
        `FEWEST`, or too many are equally good to tell a best quarter from the others.
    """
    values = sorted((tried.value for tried in trials if tried.value is not None), reverse=True)
    if len(values) < FEWEST or values[math.ceil(BEST * len(values)) - 1] == values[-1]:
        return None
    found = get_param_importances(
        _study(sweep, trials, RandomSampler(seed=0), NopPruner()),
        evaluator=PedAnovaImportanceEvaluator(target_quantile=BEST),
        params=sorted(sweep.space),
    )
    return dict(sorted(found.items(), key=lambda each: (-each[1], each[0])))


def _asked(sweep: Sweep, past: tuple[Tried, ...]) -> list[Order]:
    """The next generation."""
    study = _study(sweep, past, _sampler(sweep, len(past) // sweep.generation), NopPruner())
    distributions = _distributions(sweep)
    numbers = range(len(past), min(len(past) + sweep.generation, sweep.trials))
    return [
        Order(sweep, number, _plain(sweep, study.ask(distributions).params), past)
        for number in numbers
    ]


def _study(
    sweep: Sweep, trials: Iterable[Tried], sampler: BaseSampler, pruner: BasePruner
) -> optuna.Study:
    """Trials as a study in memory."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(direction="maximize", sampler=sampler, pruner=pruner)
    distributions = _distributions(sweep)
    for tried in trials:
        study.add_trial(_frozen(sweep, tried, distributions))
    return study


def _frozen(sweep: Sweep, tried: Tried, distributions: dict[str, BaseDistribution]) -> FrozenTrial:
    params = {
        name: json.dumps(value) if isinstance(sweep.space[name], Choices) else value
        for name, value in tried.params.items()
    }
    return optuna.trial.create_trial(
        state=_STATES[tried.state],
        value=tried.value,
        params=params,
        distributions=distributions,
        intermediate_values=tried.intermediate,
        system_attrs=tried.rungs,
    )


def _plain(sweep: Sweep, params: dict[str, Any]) -> dict[str, Any]:
    """What Optuna has drawn, as a configuration takes it."""
    return {
        name: json.loads(params[name]) if isinstance(values, Choices) else params[name]
        for name, values in sorted(sweep.space.items())
    }


def _distributions(sweep: Sweep) -> dict[str, BaseDistribution]:
    return {name: _distribution(values) for name, values in sorted(sweep.space.items())}


def _distribution(values: Span | Choices) -> BaseDistribution:
    if isinstance(values, Choices):  # as text, since Optuna takes no lists
        return CategoricalDistribution([json.dumps(choice) for choice in values.choices])
    if isinstance(values.low, int) and isinstance(values.high, int):
        return IntDistribution(values.low, values.high, values.log)
    return FloatDistribution(values.low, values.high, values.log)


def _sampler(sweep: Sweep, generation: int) -> BaseSampler:
    seed = int(np.random.SeedSequence((sweep.seed, generation)).generate_state(1)[0])
    if sweep.sampler == "random":
        return RandomSampler(seed=seed)
    return TPESampler(seed=seed, n_startup_trials=sweep.startup_trials)


def _pruner(sweep: Sweep) -> BasePruner:
    """As rl-baselines3-zoo has them."""
    if sweep.pruner == "median":
        return MedianPruner(sweep.startup_trials, n_warmup_steps=sweep.evaluations // 3)
    if sweep.pruner == "halving":
        return SuccessiveHalvingPruner(min_resource=1)
    return NopPruner()
