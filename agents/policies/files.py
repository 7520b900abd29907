"""A policy on disk: weights that run no code, and the YAML that says what they are for."""

import json
from dataclasses import asdict
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
import yaml

from surface_gym.tasks import Task
from surface_gym.whole_files import replacing

from ..damage import DAMAGE, told
from ..flow.policy import FlowPolicy, make_seat_network
from ..modules.network import SharedNetwork
from ..modules.policy import ModulesPolicy
from ..policy_card import CARD, PolicyCard
from ..policy_files import WEIGHTS, PolicyFiles, read_files
from .policy import Policy, make_network

DIGEST = "digest"  # field of the card: of its other fields and the weights


def save_policy(network: torch.nn.Module, card: PolicyCard, folder: Path) -> None:
    """Write weights and card into a folder, each whole or not at all."""
    written = BytesIO()
    torch.save(network.state_dict(), written)
    weights = written.getvalue()
    with replacing(folder / WEIGHTS) as part:
        part.write_bytes(weights)
    fields = {**asdict(card), "hidden": list(card.hidden), "observe": list(card.observe)}
    fields[DIGEST] = _digest(fields, weights)
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
        if fields.pop(DIGEST) != _digest(fields, files.weights):
            raise ValueError(f"{WEIGHTS} or {CARD} is not as it was written: its digest differs")
        arrays = {name: tuple(fields[name]) for name in ("hidden", "observe") if name in fields}
        card = PolicyCard(**{**fields, **arrays})
        weights = torch.load(BytesIO(files.weights), map_location="cpu", weights_only=True)
        if card.algo == "parcels":
            seats = make_seat_network(card)
            _fill(seats, weights)
            return FlowPolicy(seats, card)
        settings = card.settings(task)
        if card.algo == "modules":
            shared = SharedNetwork(len(settings.chosen_orientations), card.hidden, card.observe)
            _fill(shared, weights)
            return ModulesPolicy(shared, card)
        network = make_network(card, settings)
        _fill(network, weights)
    except DAMAGE as error:
        raise ValueError(
            f"{files.folder} holds a damaged or foreign policy: {told(error)}"
        ) from None
    return Policy(network, card, settings)


def _digest(fields: dict[str, Any], weights: bytes) -> str:
    return sha256(json.dumps(fields, sort_keys=True).encode() + weights).hexdigest()


def _fill(network: torch.nn.Module, weights: Any) -> None:
    """Give a network its weights, which must be of its own kind: PyTorch would convert them."""
    for name, wanted in network.state_dict().items():
        if weights[name].dtype != wanted.dtype:
            raise ValueError(f"{name} must be {wanted.dtype}, got {weights[name].dtype}")
        if not bool(torch.isfinite(weights[name]).all()):
            raise ValueError(f"{name} must be finite")
    network.load_state_dict(weights)
