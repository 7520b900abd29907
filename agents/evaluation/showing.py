"""The films: at what starts, and of whom."""

from pathlib import Path
from typing import Any

from surface_gym.conditions import CONDITIONS
from surface_gym.settings import Settings

from ..controller import Controller
from .contenders import Contender
from .films import write_film
from .trials import SEED, make_trial

# Where what a fixed layout cannot do is easy to see.
SHOWN: dict[str, dict[str, Any]] = {
    "sort": {"speed": 0.6, "parcel": "S", "side": 1},
    "slow": {"speed": 1.8, "parcel": "B", "ratio": 0.4},
    "stop": {"speed": 1.2, "parcel": "S", "position": 1.2},
    "track": {"speed": 0.8, "parcel": "S", "tilt": 0.21},
    "orient": {"speed": 1.5, "parcel": "B", "angle": 0.5236},
}
TOLD = {
    "sort": "the S-box at 0.6 m/s, to y > 0",
    "slow": "the B-box at 1.8 m/s, to 0.4 of it",
    "stop": "the S-box at 1.2 m/s, at x = 1.2 m",
    "track": "the S-box on a sine, at 12 deg of tilt",
    "orient": "the B-box at 1.5 m/s, by 30 deg",
}


def film_of(contenders: list[Contender], folder: Path) -> tuple[Path, str]:
    """Film contenders of a task side by side, first seed of each; the file and what it shows."""
    trial = make_trial(contenders[0].task)
    players: dict[str, tuple[Controller, Settings]] = {}
    for contender in contenders:
        settings = contender.settings(trial, CONDITIONS["exact"])
        players[contender.name] = (contender.make(settings, contender.seeds[0]), settings)
    file = folder / f"{trial.label}.mp4"
    done = write_film(players, SHOWN.get(trial.kind, {}), SEED, file)
    outcomes = ", ".join(
        f"{name} {'succeeds' if success else 'fails'}"
        for name, success in zip(players, done, strict=True)
    )
    return file, f"{TOLD.get(trial.kind, 'a start drawn by the task')}: {outcomes}"
