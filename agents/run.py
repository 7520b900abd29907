"""A run's folder, and the report both `train.py` and `evaluate.py` end with."""

import sys
from dataclasses import fields
from datetime import datetime
from pathlib import Path

import yaml
from rich.console import Console

from agents.comparison import SortRecord, compare_sorting
from agents.config import TrainConfig
from agents.controller import Controller
from agents.fixed_layout import FixedLayout
from agents.plots import draw_trajectories
from agents.policy import Policy
from agents.report import print_table, write_table
from agents.video import record_sort
from surface_gym.settings import Settings

FIXED = "fixed layout"
AGENT = "PPO agent"
SHOWN_SPEED = 0.6  # [m/s] of the video, where the fixed layout fails


def make_run_folder(config: TrainConfig) -> Path:
    """A new folder that holds the resolved config and the command.

    Raises:
        ValueError: the folder exists.
    """
    name = config.name or f"sort-ppo-seed{config.seed}-{datetime.now():%Y%m%d-%H%M%S}"
    folder = config.out / name
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise ValueError(f"name must be that of a new folder, got {folder}") from None
    resolved = {field.name: getattr(config, field.name) for field in fields(config)}
    plain = {
        key: list(value)
        if isinstance(value, tuple)
        else str(value)
        if isinstance(value, Path)
        else value
        for key, value in resolved.items()
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(plain, sort_keys=False))
    (folder / "command.txt").write_text(" ".join(["python", *sys.argv]) + "\n")
    return folder


def report(policy: Policy, folder: Path, console: Console) -> list[SortRecord]:
    """Compare a policy with the fixed layout: table, plot and video into a folder."""
    settings = Settings(**policy.env_kwargs)
    controllers: dict[str, tuple[Controller, Settings]] = {
        FIXED: (FixedLayout(settings), settings),
        AGENT: (policy, settings),
    }
    with console.status("comparing") as status:
        records = compare_sorting(controllers, lambda part: status.update(f"comparing: {part}"))
        status.update("drawing trajectories.png")
        draw_trajectories(records, folder / "trajectories.png")
        status.update("filming sort.mp4")
        options = {"speed": SHOWN_SPEED, "parcel": "S", "side": 1}
        done = record_sort(policy, settings, options, folder, "sort")
    print_table(records, console)
    write_table(records, folder)
    outcome = "sorts it" if done else "does not sort it either"
    console.print(
        f"sort.mp4: the S-box at {SHOWN_SPEED:g} m/s, where the fixed layout fails; "
        f"the agent {outcome}"
    )
    console.print(f"everything is in {folder}")
    return records
