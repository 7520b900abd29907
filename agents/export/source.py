"""What is exported: a policy, its weights, and what is known of how it was trained."""

import shlex
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
import yaml

from surface_gym import checks
from surface_gym.conditions import CONDITIONS, Condition
from surface_gym.settings import Settings
from surface_gym.tasks import Task

from .. import library
from ..evaluation.contenders import policies_of
from ..learning.card import FILE as CARD_FILE
from ..learning.config import NOMINAL
from ..learning.folder import CONFIG, open_folder
from ..modules.policy import ModulesPolicy
from ..policies.files import DIGEST
from ..policies.policy import Policy
from ..policy_files import read_files
from ..tasks import find_task

# Conditions of the lanes that were practised on, by what `train.py --condition` says.
PRACTISED: dict[str, tuple[str, ...]] = {NOMINAL: ("exact", "camera"), "lab": ("exact", "lab")}


@dataclass(frozen=True, eq=False)
class Training:
    """How an agent came about, as far as its folder tells."""

    condition: str  # what it was to be ready for
    command: str | None = None  # that trains it; None: not told
    results: tuple[tuple[str, float], ...] = ()  # [-] success under conditions; none: not told

    @property
    def practised(self) -> tuple[Condition, ...]:
        """Conditions of the lanes that it practised on."""
        names = PRACTISED.get(self.condition, (self.condition,))
        return tuple(CONDITIONS[checks.one_of("condition", name, CONDITIONS)] for name in names)


@dataclass(frozen=True, eq=False)
class Source:
    """A policy to export."""

    name: str
    seed: int
    policy: Policy | ModulesPolicy
    settings: Settings  # of the environment it is for
    weights: dict[str, torch.Tensor]
    digest: str  # of card and weights
    training: Training


def shipped(name: str, seed: int | None = None) -> Source:
    """An agent that comes with the package.

    Raises:
        ValueError: no agent of that name, or not of that seed; or of a kind that is not exported.
    """
    trained = library.seeds(name)
    chosen = trained[0] if seed is None else int(checks.one_of("seed", seed, trained))
    folder = library.SHELF / name
    return _read(name, chosen, folder / f"seed-{chosen}", None, _told(folder))


def of_run(
    run: Path, name: str | None = None, seed: int | None = None, task: str | None = None
) -> Source:
    """A policy that a run left.

    Args:
        run: its folder.
        name: that the export is to have; None: the folder's.
        seed: of several; None: the first.
        task: of one's own that it was trained on, as path/to/file.py:Class; None: of the package.

    Raises:
        ValueError: the folder holds no policy, or a damaged or foreign one, or one of another task
            or seed; or of a kind that is not exported.
    """
    folders = policies_of(run)
    chosen = next(iter(folders)) if seed is None else int(checks.one_of("seed", seed, folders))
    own = None if task is None else find_task(task)
    told = _told(run)
    if told is None and (run / CONFIG).is_file():
        told = Training(open_folder(run, task).condition)
    return _read(name or run.resolve().name, chosen, folders[chosen], own, told)


def _read(
    name: str, seed: int, folder: Path, task: Task | None, training: Training | None
) -> Source:
    files = read_files(folder)
    policy = library.carried(files, task)
    if not isinstance(policy, (Policy, ModulesPolicy)):
        raise ValueError(
            f"name must be that of an agent of single parcels (PPO, DQN or modules), got {name!r}: "
            "which module obeys which parcel of a flow is not the policy's to say"
        )
    return Source(
        name,
        seed,
        policy,
        policy.card.settings(task),
        torch.load(BytesIO(files.weights), map_location="cpu", weights_only=True),
        str(yaml.safe_load(files.card.decode())[DIGEST]),
        training or Training(NOMINAL),
    )


def _told(folder: Path) -> Training | None:
    """What the card of a folder tells of the training; None: there is none."""
    file = folder / CARD_FILE
    if not file.is_file():
        return None
    card: dict[str, Any] = yaml.safe_load(file.read_text())
    command = str(card["command"])
    words = shlex.split(command)
    asked = words[words.index("--condition") + 1] if "--condition" in words else NOMINAL
    results = tuple(
        (name, float(figures["success"]))
        for name, figures in card.get("results", {}).items()
        if "success" in figures
    )
    return Training(str(card.get("condition", asked)), command, results)
