"""A policy on disk: weights that run no code, and the YAML that says what they are for."""

from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.mirror import SIDE, ActionMirror
from surface_gym.settings import Settings

# What reading a damaged or foreign file can raise, in PyYAML, in PyTorch and here.
_DAMAGE = (
    yaml.YAMLError,
    UnpicklingError,
    EOFError,
    OSError,
    AttributeError,
    KeyError,
    RuntimeError,
    TypeError,
    ValueError,
)

WEIGHTS = "policy.pt"
CARD = "policy.yaml"


@dataclass(frozen=True)
class PolicyCard:
    """What a policy's weights are for."""

    env_id: str
    actions: str  # kind of action
    control_period: float  # [s]
    hidden: tuple[int, ...]  # units of the hidden layers

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment the policy was trained on."""
        return {"actions": self.actions, "control_period": self.control_period}


def make_network(card: PolicyCard, settings: Settings) -> ActorCriticPolicy:
    """The network of a card, its weights not set."""
    return ActorCriticPolicy(
        settings.observation_space(),
        settings.action_space(),
        lambda _: 0.0,
        net_arch=list(card.hidden),
    )


class Policy:
    """A trained policy. `predict` takes and gives what the environment does.

    Attributes:
        env_id: the environment it was trained on.
        env_kwargs: that environment's arguments.
    """

    def __init__(self, network: ActorCriticPolicy, card: PolicyCard) -> None:
        self._network = network
        self._network.set_training_mode(False)
        settings = Settings(actions=card.actions, control_period=card.control_period)
        self._mirror = ActionMirror(settings.action_kind, settings.orientations)
        self.card = card
        self.env_id = card.env_id
        self.env_kwargs = card.env_kwargs

    def predict(
        self, observation: NDArray[np.float32], deterministic: bool = True
    ) -> tuple[Any, None]:
        """Action for an observation (features,), or actions for (lanes, features); and no state."""
        single = observation.ndim == 1
        observations = observation[np.newaxis] if single else observation
        chosen, _ = self._network.predict(observations, deterministic=deterministic)
        actions = self._mirror(chosen, observations[:, SIDE])
        return (actions[0] if single else actions), None


def save_policy(network: ActorCriticPolicy, card: PolicyCard, folder: Path) -> None:
    """Write weights and card into a folder."""
    torch.save(network.state_dict(), folder / WEIGHTS)
    fields = {**asdict(card), "hidden": list(card.hidden)}
    (folder / CARD).write_text(yaml.safe_dump(fields, sort_keys=False))


def load_policy(folder: Path) -> Policy:
    """Read a policy. No code in the files is run.

    Raises:
        ValueError: the folder holds no policy, or a damaged or foreign one.
    """
    for name in (WEIGHTS, CARD):
        if not (folder / name).is_file():
            raise ValueError(f"{folder} holds no policy: {name} is missing")
    try:
        fields = yaml.safe_load((folder / CARD).read_text())
        card = PolicyCard(**{**fields, "hidden": tuple(fields["hidden"])})
        if card.env_id not in gym.registry:
            raise ValueError(f"unknown env_id {card.env_id!r}")
        network = make_network(
            card, Settings(actions=card.actions, control_period=card.control_period)
        )
        network.load_state_dict(torch.load(folder / WEIGHTS, map_location="cpu", weights_only=True))
    except _DAMAGE as error:
        raise ValueError(f"{folder} holds a damaged or foreign policy: {error}") from error
    return Policy(network, card)
