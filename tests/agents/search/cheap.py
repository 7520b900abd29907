"""A small search, and a trial of it that only reckons."""

import time
from functools import partial
from pathlib import Path

from rich.console import Console

from agents.search.command import go_on
from agents.search.study import Order, Watch
from agents.search.sweep import Choices, Span, Sweep
from agents.search.tried import COMPLETE, PRUNED, Tried
from surface_gym.sharing import Tell

SMALL = Sweep(
    task="slow",
    trials=14,
    generation=4,
    steps=40_000,
    evaluations=3,
    seed=2,
    startup_trials=4,
    space={
        "learning_rate": Span(1e-4, 1e-2, log=True),
        "n_epochs": Span(1, 9),
        "hidden": Choices([[8], [8, 8]]),
    },
)


def cheap_trial(order: Order, tell: Tell, seconds: float = 0.0) -> Tried:
    """The nearer to 1e-2 the learning rate is, the better; the rest matters little."""
    learning_rate = order.params["learning_rate"]
    value = learning_rate * 100.0 + 0.001 * order.params["n_epochs"]
    watch, seen, pruned = Watch(order), {}, False
    for look in range(1, order.sweep.looks + 1):
        time.sleep(seconds)
        seen[look] = value * look / order.sweep.looks
        tell((look, seen[look]))
        pruned = watch.prunes(look, seen[look])
        if pruned:
            break
    return Tried(
        order.number,
        order.params,
        PRUNED if pruned else COMPLETE,
        None if pruned else value,
        seen,
        watch.rungs,
        "",
        time.perf_counter(),
    )


def slow_search(folder: Path) -> None:
    """To be killed while it goes on."""
    go_on(SMALL, folder, 2, Console(quiet=True), partial(cheap_trial, seconds=0.2))
