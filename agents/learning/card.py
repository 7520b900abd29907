"""An agent's card: the command that trains it, and what came of it."""

import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from ..evaluation.columns import columns_of
from ..evaluation.contenders import FIXED, Contender
from ..evaluation.report import COMPARED
from ..evaluation.table import Summaries, value_of
from ..programs import TRAIN, typed
from .config import CPU, NOMINAL, TrainConfig, on_device
from .hyperparams import defaults
from .legs import Learned

FILE = "card.yaml"


def write_card(
    command: str,
    seeds: Sequence[int],
    learned: Sequence[Learned],
    summaries: Summaries,
    agent: Contender,
    folder: Path,
) -> None:
    """Write card.yaml into a run's folder.

    Args:
        command: that trains it.
        seeds: trained.
        learned: how each of them ended.
        summaries: of the agent and the fixed layout.
        agent: among them.
        folder: of the run.
    """
    card = {
        "command": command,
        "seeds": list(seeds),
        "steps": [each.steps for each in learned],
        "seconds": [round(each.seconds) for each in learned],  # of each seed, on a core or device
        "results": {condition: _results(summaries, agent, condition) for condition in COMPARED},
    }
    (folder / FILE).write_text(yaml.safe_dump(card, sort_keys=False))


def command_of(config: TrainConfig) -> str:
    """The command that trains the same again: what differs from the task's defaults."""
    device = config.device if on_device(config) else CPU
    default = defaults(config.task, config.algo, condition=config.condition, device=device)
    chosen = ["--task", config.task, "--algo", config.algo]
    if config.condition != NOMINAL:
        chosen += ["--condition", config.condition]
    if device != CPU:
        chosen += ["--device", device]
    for field in fields(config):
        value = getattr(config, field.name)
        if field.name not in ("out", "name") and value != getattr(default, field.name):
            values = value if isinstance(value, tuple) else (value,)
            chosen += [f"--{field.name.replace('_', '-')}", *map(str, values)]
    return typed(TRAIN, *chosen)


def _results(summaries: Summaries, agent: Contender, condition: str) -> dict[str, Any]:
    summary = summaries[agent.task, agent.name, condition]
    fixed = summaries[agent.task, FIXED, condition]
    low, high = summary.interval
    figures = {
        column.name: round(value, 5)
        for column in columns_of(agent.task)
        if not math.isnan(value := value_of(column, summary, fixed))
    }
    return {
        "success": round(summary.rate, 4),
        "interval": [round(low, 4), round(high, 4)],
        "success_of_each_seed": [round(float(each.mean()), 4) for each in summary.success],
        **figures,
    }
