"""The ladder of hardware that sorts streams, and other controllers of its modules.

The rungs differ in the number of modules per actuator. Each rung has its best scheduler.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.flow.benchmarks import SIX
from surface_gym.flow.task import Flow
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Exact

from .. import library
from ..base import Controller
from ..rules.sorting import SortEach, StreamEventRule
from ..scheduling.decisions import make_model_library
from ..scheduling.maneuvers import ColumnGroups, make_library
from ..scheduling.scheduler import CLEARANCES, Scheduler, find_plain, make_scheduler, predict_rate
from .method import METHODS, Method, shipped

TASK = Flow().name
# Rungs, named by the modules that turn together.
ARRANGED = "zone, arranged anew"
FOLLOWED = "zone, same exit follows"
SERIES = "zones in series"
TRIPLES = "columns in threes"
COLUMNS = "columns"
MODULES = "modules"
SIX_COLUMNS = "columns, six angles"
SIX_MODULES = "modules, six angles"
# Other controllers of modules.
EVENT = "event rule"
EACH = "sort-ppo for each"
LEARNED = "flow-schedule"
SCHEDULER = "scheduler"  # for streams without trained agents

# Pairs of rungs whose difference is shown.
STEPS = (
    (FOLLOWED, ARRANGED), (SERIES, FOLLOWED), (TRIPLES, SERIES), (COLUMNS, TRIPLES),
    (MODULES, COLUMNS),
    (SIX_COLUMNS, COLUMNS), (SIX_MODULES, MODULES), (SIX_MODULES, SIX_COLUMNS),
    (LEARNED, MODULES),
)  # fmt: skip
ZONES = (ARRANGED, FOLLOWED, SERIES)  # rungs whose columns are chosen for each stream
BOUNDED = (MODULES, SIX_MODULES)  # rungs with a shown best known rate
ON_FILM = (ARRANGED, SERIES, COLUMNS, MODULES)

SHORTEST = 4  # minimum columns of a zone; fewer are almost single columns
# minimum columns of zones in series; in shorter zones, a parcel is over two of them
SHORTEST_OF_MANY = 5
WIDEST = 20  # maximum columns of a zone
LONGER = 2  # additional columns to try beyond the best zone
PREDICTED = 500  # parcels of a prediction


@METHODS.registered(TASK)
def ladder() -> list[Method]:
    """List the rungs, then other controllers of modules."""
    columns, modules = partial(_schedule, ColumnGroups()), partial(_schedule, None)
    return [
        _rung(ARRANGED, "modules", partial(_schedule_zones, SHORTEST, 1, True)),
        _rung(FOLLOWED, "modules", partial(_schedule_zones, SHORTEST, 1, False)),
        _rung(SERIES, "modules", partial(_schedule_zones, SHORTEST_OF_MANY, None, False)),
        _rung(TRIPLES, "modules", partial(_schedule, ColumnGroups(3))),
        _rung(COLUMNS, "modules", columns),
        _rung(SIX_COLUMNS, "modules", columns, SIX),
        _rung(MODULES, "parcels", modules),
        _rung(SIX_MODULES, "parcels", modules, SIX),
        Method(EVENT, TASK, partial(_alone, StreamEventRule), {"actions": "parcels"}),
        Method(EACH, TASK, partial(_alone, SortEach), {"actions": "parcels"}, presets=("exact",)),
        *(replace(each, seeds=each.seeds[:1]) for each in _learned()),
    ]


def methods_of_unseen() -> list[Method]:
    """List the methods for streams without trained agents."""
    scheduler = _rung(SCHEDULER, "parcels", make_best_scheduler)
    return [scheduler, *_learned()]


def _learned() -> list[Method]:
    """Return the shipped agent, with the name of its policies as label."""
    return [replace(each, name=LEARNED) for each in shipped(TASK)]


def _rung(
    name: str, actions: str, make: Callable[..., Controller | None],
    orientations: tuple[float, ...] | None = None,
) -> Method:  # fmt: skip
    given: dict[str, Any] = {"actions": actions, "gate": True, "queue": library.QUEUE}
    if orientations is not None:
        given["orientations"] = orientations
    return Method(name, TASK, make, given)


def _alone(make: Callable[[EnvConfig], Controller], config: EnvConfig, _seed: int) -> Controller:
    return make(config)


def _schedule(groups: ColumnGroups | None, config: EnvConfig, _seed: int) -> Scheduler | None:
    return make_scheduler(config, groups)


def _schedule_zones(
    shortest: int, count: int | None, exclusive: bool, config: EnvConfig, _seed: int
) -> Scheduler | None:
    """Make the scheduler of the zones with the highest predicted rate, by their columns.

    Returns None if no zones sort all parcels.
    """
    rates: dict[ColumnGroups, float] = {}
    exact = replace(config, sensors=Exact(), randomisation=Randomisation())
    for columns in range(shortest, WIDEST + 1):
        if rates and columns > max(rates, key=rates.__getitem__).columns + LONGER:
            break
        groups = ColumnGroups(columns, count, exclusive)
        made = make_library(exact, groups, slack=CLEARANCES[0][0])
        if made.correct.all() and np.isfinite(made.gaps).all():
            odds, queue = np.ones(len(made.signature)), config.stream_task.queue
            rates[groups] = predict_rate(made, odds, PREDICTED, queue)
    tried = (
        make_scheduler(config, groups)
        for groups in sorted(rates, key=rates.__getitem__, reverse=True)
    )
    return next((scheduler for scheduler in tried if scheduler is not None), None)


def make_best_scheduler(config: EnvConfig, _seed: int, most_touches: float = 0.0) -> Scheduler:
    """Make the better of two schedulers: for the nominal surface, or for axes without delay."""
    whole = [make_model_library(config)]
    if config.actuators.stuck_share and math.isfinite(config.actuators.axis_speed):
        whole.append(make_model_library(config.replace(actuators=sg.Actuators())))
    found = [find_plain(config, made, most_touches) for made in whole]
    return max(found, key=itemgetter(1))[0]


def count_hardware(config: EnvConfig, controller: Controller) -> tuple[int, int, int]:
    """Return the number of actuators, and the columns and modules per actuator."""
    first_row, rows, first, obeying = config.site.zone
    grid = config.site.rotor[first_row : first_row + rows, first : first + obeying]
    lead = controller.library.lead if isinstance(controller, Scheduler) else None
    if lead is None or lead.groups is None:
        return int(grid.sum()), 0, 1
    each = [int(grid[:, begin:end].sum()) for begin, end in lead.spans.tolist()]
    return sum(count > 0 for count in each), lead.groups.columns, max(each)
