"""One cell of the comparison: a contender's seed on a task under a condition."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.conditions import CONDITIONS
from surface_gym.settings import Settings

from ..episodes import Episodes, run_apart, run_episodes
from .contenders import Contender
from .drawn import drawn_parcels
from .trials import SEED, Trial, make_trial

Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """How each start went; plain lists, as a file keeps them."""

    task: str
    contender: str
    condition: str
    seed: int
    success: list[bool]  # (starts,)
    time: list[float]  # (starts,) [s]
    columns: list[int]  # (starts,) of the zone that the parcel's front reached; 0 on a field
    figures: dict[str, list[float]]  # the task's own, (starts,) each
    decision_time: float  # [s] a decision of one lane

    @property
    def key(self) -> tuple[str, str, str, int]:
        """What it is the cell of."""
        return (self.task, self.contender, self.condition, self.seed)

    def plain(self) -> dict[str, Any]:
        """As JSON takes it."""
        return asdict(self)


def trial_of(contender: Contender) -> Trial:
    """The starts a contender is tried on."""
    trial = make_trial(contender.task)
    return trial if contender.starts is None else trial.some(contender.starts)


def play(contender: Contender, seed: int, condition_name: str) -> tuple[Cell, Episodes]:
    """Run a contender's seed on its task under a condition."""
    condition = CONDITIONS[condition_name]
    trial = trial_of(contender).under(condition)
    settings = contender.settings(trial, condition)
    controller = contender.make(settings, seed)
    run = run_episodes if contender.starts is None else run_apart
    episodes = run(controller, settings, trial.starts, SEED)
    cell = Cell(
        task=contender.task,
        contender=contender.name,
        condition=condition_name,
        seed=seed,
        success=episodes.success.tolist(),
        time=episodes.time.tolist(),
        columns=_columns(trial, settings, episodes),
        figures={name: values.tolist() for name, values in episodes.figures.items()},
        decision_time=episodes.decision_time,
    )
    return cell, episodes


def compute(contender: Contender, seed: int, condition_name: str) -> Cell:
    """`play` for a process of its own."""
    return play(contender, seed, condition_name)[0]


def _columns(trial: Trial, settings: Settings, episodes: Episodes) -> list[int]:
    """Columns of the zone that the front edge reached, at the decisions and at the end."""
    if trial.kind != "sort":
        return [0] * len(trial.starts)
    plant = settings.chosen_plant
    touched = []
    for k, parcel in enumerate(drawn_parcels(settings, trial.starts, SEED)):
        base = parcel.base
        _, (_, _, first, _) = plant.site(base, None)
        x, _, theta = episodes.path(k).T
        from_centre = base.outline - base.centroid
        reach = (from_centre @ np.array([np.cos(theta), -np.sin(theta)])).max(axis=0)
        touched.append(int(np.floor((x + reach).max() / plant.pitch_x + 0.5)) - first)
    return touched
