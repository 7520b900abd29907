"""What the policies of a flow's run come to: their capacities, beside the reservation's."""

from functools import partial
from pathlib import Path

import yaml
from rich.console import Console

from surface_gym.flow.settings import FlowSettings
from surface_gym.registration import FLOW
from surface_gym.sharing import Workers

from .. import library
from ..controller import Controller
from ..evaluation.contenders import policies_of
from ..evaluation.table import markdown, print_table
from ..policy_card import CARD
from ..policy_files import PolicyFiles, read_files
from .cases import CONDITIONS
from .contenders import RESERVATION, FlowContender, contenders
from .results import Results, results_of
from .study import compute_flows
from .tables import capacities, eased

TABLE = "table.md"


def compare_parcels(run: Path, workers: Workers, console: Console) -> Results:
    """Measure the policies of a run, into the run's folder.

    Raises:
        ValueError: the folder holds no policy, or a damaged one.
    """
    reservation = next(each for each in contenders() if each.name == RESERVATION)
    who = [reservation, *_of_seeds(policies_of(run))]
    results = results_of(who, compute_flows(who, workers, loads=()))
    tables = [kind(results, name) for name in CONDITIONS for kind in (capacities, eased)]
    (run / TABLE).write_text("\n".join(map(markdown, tables)))
    for table in tables:
        print_table(table, console)
    console.print(f"everything is in {run}")
    return results


def _of_seeds(folders: dict[int, Path]) -> list[FlowContender]:
    files = {seed: read_files(folder) for seed, folder in folders.items()}
    period = library.carried(next(iter(files.values()))).card.control_period
    return [
        FlowContender(f"seed {seed}", "parcels", True, partial(_read, each), control_period=period)
        for seed, each in files.items()
    ]


def _read(files: PolicyFiles, settings: FlowSettings) -> Controller:
    del settings
    return library.carried(files)


def is_of_flow(run: Path) -> bool:
    """Whether the first policy of a run says that it is for a flow; a damaged one says nothing."""
    folder = next(iter(policies_of(run).values()))
    try:
        return bool(yaml.safe_load((folder / CARD).read_text())["env_id"] == FLOW)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return False
