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
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.dqn.policies import DQNPolicy

from agents.learning.categorical import EqualChoicesPolicy
from agents.mirror import SIDE, ActionMirror
from surface_gym.registration import env_id
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS

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

NETWORKS = {"ppo": EqualChoicesPolicy, "dqn": DQNPolicy}
WEIGHTS = "policy.pt"
CARD = "policy.yaml"


@dataclass(frozen=True)
class PolicyCard:
    """What a policy's weights are for."""

    env_id: str
    algo: str  # "ppo" or "dqn"
    actions: str  # kind of action
    control_period: float  # [s]
    hidden: tuple[int, ...]  # units of the hidden layers

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment the policy was trained on."""
        return {"actions": self.actions, "control_period": self.control_period}

    @property
    def task(self) -> str:
        """The task's name."""
        return str(gym.spec(self.env_id).kwargs["task"])

    @property
    def settings(self) -> Settings:
        """Those of the environment the policy is for."""
        return Settings(task=self.task, **self.env_kwargs)


def make_network(card: PolicyCard) -> BasePolicy:
    """The network of a card, its weights not set."""
    settings = card.settings
    return NETWORKS[card.algo](
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

    def __init__(self, network: BasePolicy, card: PolicyCard) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        self._network = network
        self._network.set_training_mode(False)
        settings = card.settings
        # Sort shows its parcel in a mirror where it is to go to y < 0.
        self._mirror = (
            ActionMirror(settings.action_kind, settings.orientations)
            if card.task == "sort"
            else None
        )
        self.card = card
        self.env_id = card.env_id
        self.env_kwargs = card.env_kwargs

    def predict(
        self,
        observation: NDArray[np.float32],
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:
        """Action for an observation (features,), or actions for (lanes, features); and no state."""
        del state, episode_start  # it has no memory
        single = observation.ndim == 1
        observations = observation[np.newaxis] if single else observation
        actions, _ = self._network.predict(observations, deterministic=deterministic)
        if self._mirror is not None:
            actions = self._mirror(actions, observations[:, SIDE])
        return (actions[0] if single else actions), None


def save_policy(network: BasePolicy, card: PolicyCard, folder: Path) -> None:
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
        if card.env_id not in map(env_id, TASKS):
            raise ValueError(f"unknown env_id {card.env_id!r}")
        network = make_network(card)
        network.load_state_dict(torch.load(folder / WEIGHTS, map_location="cpu", weights_only=True))
    except _DAMAGE as error:
        raise ValueError(f"{folder} holds a damaged or foreign policy: {error}") from error
    return Policy(network, card)
