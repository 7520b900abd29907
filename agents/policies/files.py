"""A policy on disk: weights that run no code, and the YAML that says what they are for."""

from dataclasses import asdict
from pathlib import Path

import torch
import yaml

from agents.damage import DAMAGE
from agents.flow.policy import FlowPolicy, make_seat_network
from agents.modules.network import SharedNetwork
from agents.modules.policy import ModulesPolicy
from agents.policies.policy import Policy, make_network
from agents.policy_card import CARD, PolicyCard
from surface_gym.tasks import Task

WEIGHTS = "policy.pt"


def save_policy(network: torch.nn.Module, card: PolicyCard, folder: Path) -> None:
    """Write weights and card into a folder."""
    torch.save(network.state_dict(), folder / WEIGHTS)
    fields = {**asdict(card), "hidden": list(card.hidden)}
    (folder / CARD).write_text(yaml.safe_dump(fields, sort_keys=False))


def load_policy(folder: Path, task: Task | None = None) -> Policy | ModulesPolicy | FlowPolicy:
    """The policy that a run left in a folder, whatever learned it. No code in the files is run.

    Args:
        folder: of the run.
        task: of one's own that it was trained on; None: one of the package.

    Raises:
        ValueError: the folder holds no policy, or a damaged or foreign one, or one of another task.
    """
    for name in (WEIGHTS, CARD):
        if not (folder / name).is_file():
            raise ValueError(f"{folder} holds no policy: {name} is missing")
    try:
        fields = yaml.safe_load((folder / CARD).read_text())
        card = PolicyCard(**{**fields, "hidden": tuple(fields["hidden"])})
        weights = torch.load(folder / WEIGHTS, map_location="cpu", weights_only=True)
        if card.algo == "parcels":
            seats = make_seat_network(card)
            seats.load_state_dict(weights)
            return FlowPolicy(seats, card)
        settings = card.settings(task)
        if card.algo == "modules":
            shared = SharedNetwork(len(settings.chosen_orientations), card.hidden)
            shared.load_state_dict(weights)
            return ModulesPolicy(shared, card)
        network = make_network(card, settings)
        network.load_state_dict(weights)
    except DAMAGE as error:
        raise ValueError(f"{folder} holds a damaged or foreign policy: {error}") from error
    return Policy(network, card, settings)
