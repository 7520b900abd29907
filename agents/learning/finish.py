"""What a run ends with: its policies beside the fixed layout, and a card."""

from pathlib import Path

from rich.console import Console

from surface_gym.sharing import Workers

from ..evaluation.command import evaluate_run
from ..flow.trained import compare_parcels
from ..policy_card import FLOW_TASK
from ..programs import TRAIN, typed
from .card import command_of, write_card
from .config import TrainConfig
from .flow_card import write_flow_card
from .legs import Learned


def finish(
    config: TrainConfig, folder: Path, learned: list[Learned], console: Console, workers: Workers
) -> None:
    """Compare what was learned with the fixed layout; a run broken off is only told of."""
    if len(learned) < config.seeds or any(each.interrupted for each in learned):
        console.print(
            f"interrupted: {folder} holds what was learned so far; "
            f"{typed(TRAIN, '--resume', str(folder))} goes on from the last checkpoint"
        )
        return
    if config.task == FLOW_TASK:
        write_flow_card(config, learned, compare_parcels(folder, workers, console), folder)
        return
    agent, summaries = evaluate_run(folder, config.task, workers, console)
    seeds = range(config.seed, config.seed + config.seeds)
    write_card(command_of(config), seeds, learned, summaries, agent, folder)
