"""A policy on disk: weights that run no code, and the YAML that says what they are for."""

from dataclasses import asdict
from io import BytesIO
from pathlib import Path

import torch
import yaml

from agents.damage import DAMAGE
from agents.flow.policy import FlowPolicy, make_seat_network
from agents.modules.network import SharedNetwork
from agents.modules.policy import ModulesPolicy
from agents.policies.policy import Policy, make_network
from agents.policy_card import CARD, PolicyCard
from agents.policy_files import WEIGHTS, PolicyFiles, read_files
from surface_gym.tasks import Task
from surface_gym.whole_files import replacing


def save_policy(network: torch.nn.Module, card: PolicyCard, folder: Path) -> None:
    """Write weights and card into a folder, each whole or not at all."""
    with replacing(folder / WEIGHTS) as part:
        torch.save(network.state_dict(), part)
    fields = {**asdict(card), "hidden": list(card.hidden)}
    with replacing(folder / CARD) as part:
        part.write_text(yaml.safe_dump(fields, sort_keys=False))


def load_policy(folder: Path, task: Task | None = None) -> Policy | ModulesPolicy | FlowPolicy:
    """The policy that a run left in a folder, whatever learned it. No code in the files is run.

    Args:
        folder: of the run.
        task: of one's own that it was trained on; None: one of the package.

    Raises:
        ValueError: the folder holds no policy, or a damaged or foreign one, or one of another task.
    """
    return policy_of(read_files(folder), task)


def policy_of(files: PolicyFiles, task: Task | None = None) -> Policy | ModulesPolicy | FlowPolicy:
    """The policy that files hold, which may have been read elsewhere. No code in them is run.

    Args:
        files: of the policy.
        task: of one's own that it was trained on; None: one of the package.

    Raises:
        ValueError: they are damaged or foreign, or of another task.
    """
    try:
        fields = yaml.safe_load(files.card.decode())
        card = PolicyCard(**{**fields, "hidden": tuple(fields["hidden"])})
        weights = torch.load(BytesIO(files.weights), map_location="cpu", weights_only=True)
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
        raise ValueError(f"{files.folder} holds a damaged or foreign policy: {error}") from error
    return Policy(network, card, settings)
