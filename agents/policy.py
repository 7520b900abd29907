"""Trained policies of Stable-Baselines3's networks, and policies of all algorithms on disk.

A policy on disk is a safetensors file of weights and a YAML card; neither holds code.
"""

import json
from dataclasses import asdict
from hashlib import sha256
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import safetensors.torch
import torch
import yaml
from gymnasium import spaces
from stable_baselines3.common import policies
from stable_baselines3.common.distributions import MultiCategoricalDistribution
from stable_baselines3.dqn.policies import DQNPolicy
from torch.distributions import Categorical

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.files import DAMAGE, check_archive, describe_damage, replacing
from surface_gym.tasks import TASKS, Task

from .base import SIDE, BatchController, action_mirror
from .library import CARD, WEIGHTS, PolicyCard, PolicyFiles, read_files
from .local_policy import LocalNetwork, LocalPolicy
from .module_policy import ModulePolicy, SharedNetwork
from .parcel_policy import ParcelNetwork, ParcelPolicy
from .schedule_policy import ScheduleNetwork, SchedulePolicy
from .yaml_file import parse_yaml

ZIP = b"PK"  # begins PyTorch's archives
DIGEST = "digest"  # field of the card: of its other fields and the weights


class EqualCategoricals(MultiCategoricalDistribution):
    """Independent choices, each among the same number of options, as one categorical of an array.

    Stable-Baselines3 keeps a list of distributions and loops over it; with tens of choices that
    costs more than the network.
    """

    def __init__(self, choices: int, options: int) -> None:
        super().__init__([options] * choices)
        self._shape = (choices, options)

    def proba_distribution(self, action_logits: torch.Tensor) -> "EqualCategoricals":
        """Set the logits (num_envs, choices x options), those of a choice side by side."""
        logits = action_logits.reshape(-1, *self._shape)
        self._each: Any = Categorical(logits=logits, validate_args=False)  # its methods are untyped
        return self

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        each: torch.Tensor = self._each.log_prob(actions)
        return each.sum(dim=1)

    def entropy(self) -> torch.Tensor:
        each: torch.Tensor = self._each.entropy()
        return each.sum(dim=1)

    def sample(self) -> torch.Tensor:
        """Draw actions (num_envs, choices) by inverting the cumulative probabilities."""
        edges = self._each.probs.cumsum(dim=2)[:, :, :-1]
        uniform = torch.rand((*edges.shape[:2], 1), device=edges.device)
        return (uniform > edges).sum(dim=2)

    def mode(self) -> torch.Tensor:
        return self._each.logits.argmax(dim=2)


class EqualChoicesPolicy(policies.ActorCriticPolicy):
    """Stable-Baselines3's actor and critic, with `EqualCategoricals` where the action space is a
    MultiDiscrete of equal choices. Names and shapes of its parameters are the same.
    """

    def _build(self, lr_schedule: Any) -> None:
        space = self.action_space
        if isinstance(space, spaces.MultiDiscrete) and len(set(space.nvec.tolist())) == 1:
            self.action_dist = EqualCategoricals(len(space.nvec), int(space.nvec[0]))
        super()._build(lr_schedule)


NETWORKS = {"ppo": EqualChoicesPolicy, "dqn": DQNPolicy}


def make_network(card: PolicyCard, config: EnvConfig) -> policies.BasePolicy:
    """Build the network of a card for an environment, its weights not set."""
    return NETWORKS[card.algo](
        config.observation_space(), config.action_space(), lambda _: 0.0, net_arch=list(card.hidden)
    )


class Policy(BatchController):
    """A trained PPO or DQN policy."""

    def __init__(self, network: policies.BasePolicy, card: PolicyCard, config: EnvConfig) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        self._network = network
        self._network.set_training_mode(False)
        self._mirror = action_mirror(config)
        self._shape = (len(config.features),)
        self.card = card
        self.env_id = card.env_id
        own = {} if card.task in TASKS else {"task": config.task}
        self.env_kwargs = {**own, **card.env_kwargs}

    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        actions = self._network.predict(batch, deterministic=deterministic)[0]
        return (actions if self._mirror is None else self._mirror(actions, batch[:, SIDE])), None


AnyPolicy = Policy | ModulePolicy | SchedulePolicy | ParcelPolicy | LocalPolicy


def save_policy(network: torch.nn.Module, card: PolicyCard, folder: Path) -> None:
    """Write weights and card into a folder, each whole or not at all."""
    weights = safetensors.torch.save(network.state_dict())
    with replacing(folder / WEIGHTS) as part:
        part.write_bytes(weights)
    fields = {**asdict(card), "hidden": list(card.hidden), "observe": list(card.observe)}
    fields[DIGEST] = _digest(fields, weights)
    with replacing(folder / CARD) as part:
        part.write_text(yaml.safe_dump(fields, sort_keys=False))


def load_policy(folder: Path, task: Task | None = None) -> AnyPolicy:
    """Read the policy that a run of any algorithm left in a folder; see `library.read`."""
    return build_policy(read_files(folder), task)


def build_policy(
    files: PolicyFiles,
    task: Task | None = None,
    config: EnvConfig | None = None,
    most_touches: float = 0.0,
) -> AnyPolicy:
    """Build a policy from the content of its files. No code in them is run.

    Args:
        config: of the stream's environment, for a policy of streams; None: its own.
        most_touches: [-] per delivery that such a policy allows in its trial.

    Raises:
        ValueError: they are damaged or foreign, or of another task.
    """
    try:
        fields = parse_yaml(files.card.decode())
        if fields.pop(DIGEST) != _digest(fields, files.weights):
            raise ValueError(f"{WEIGHTS} or {CARD} is not as it was written: its digest differs")
        for name in {"hidden", "observe"} & fields.keys():
            fields[name] = tuple(fields[name])
        card = PolicyCard(**fields)
        weights = read_weights(files)
        _check_hidden(card, len(files.weights))
        if card.algo == "schedule":
            scores = ScheduleNetwork(card.hidden)
            _load_weights(scores, weights)
            return SchedulePolicy(scores, card, config, most_touches)
        if card.algo == "parcels":
            usual = EnvConfig(card.task, **card.env_kwargs)
            features, choices = usual.row_space().shape[0], len(usual.chosen_orientations)
            attention = ParcelNetwork(features, choices, card.hidden)
            _load_weights(attention, weights)
            return ParcelPolicy(attention, card, config)
        if card.algo == "local":
            choices = len(EnvConfig(card.task, **card.env_kwargs).chosen_orientations)
            local = LocalNetwork(choices, card.hidden)
            _load_weights(local, weights)
            return LocalPolicy(local, card, config)
        own = card.env_config(task)
        if card.algo == "modules":
            shared = SharedNetwork(len(own.chosen_orientations), card.hidden, card.observe)
            _load_weights(shared, weights)
            return ModulePolicy(shared, card)
        network = make_network(card, own)
        _load_weights(network, weights)
    except DAMAGE as error:
        raise ValueError(
            f"{files.folder} holds a damaged or foreign policy: {describe_damage(error)}"
        ) from None
    return Policy(network, card, own)


def _digest(fields: dict[str, Any], weights: bytes) -> str:
    return sha256(json.dumps(fields, sort_keys=True).encode() + weights).hexdigest()


def read_weights(files: PolicyFiles) -> dict[str, torch.Tensor]:
    """Read a policy's weights by their names: of safetensors, or of PyTorch's archive before it."""
    if files.weights.startswith(ZIP):
        return load_tensors(BytesIO(files.weights))
    try:
        return safetensors.torch.load(files.weights)
    except safetensors.SafetensorError as error:
        raise ValueError(f"{WEIGHTS}: {error}") from None


def load_tensors(stream: IO[bytes], plain: int = 2**16) -> dict[str, Any]:
    """Load tensors and plain values by their names, as PyTorch saves them; no code is run.

    Plain values, which PyTorch reads slowly, have so many bytes at most; policies have 2000. What
    is not as it was written, or claims more than there is, is one of the errors of `DAMAGE`.
    """
    check_archive(stream, plain)
    stream.seek(0)
    found = torch.load(stream, map_location="cpu", weights_only=True)
    if not isinstance(found, dict):
        raise ValueError(f"it must hold tensors by name, got a {type(found).__name__}")
    return found


def check_tensor(name: str, found: Any, wanted: torch.Tensor) -> None:
    """Raise a ValueError unless a tensor is finite and of the type and shape of another."""
    if not isinstance(found, torch.Tensor):
        raise ValueError(f"{name} must be a tensor, got a {type(found).__name__}")
    for what, has, asked in (
        ("type", found.dtype, wanted.dtype),
        ("shape", tuple(found.shape), tuple(wanted.shape)),
    ):
        if has != asked:
            raise ValueError(f"{name} must have the {what} {asked}, got {has}")
    if not bool(torch.isfinite(found).all()):
        raise ValueError(f"{name} must be finite")


def check_like(name: str, found: Any, own: Any) -> None:
    """Raise a ValueError unless values have the names, the types and the shapes of others.

    Numbers must be finite, and whole ones at least 0.
    """
    if isinstance(own, torch.Tensor):
        check_tensor(name, found, own)
    elif isinstance(own, float):
        checks.number(name, found)
    elif isinstance(own, int) and not isinstance(own, bool):
        checks.integer(name, found, least=0, most=2**53)
    elif not isinstance(found, dict if isinstance(own, dict) else type(own)):
        raise ValueError(f"{name} must be a {type(own).__name__}, got a {type(found).__name__}")
    elif isinstance(own, dict):
        if found.keys() != own.keys():
            raise ValueError(f"{name} must hold {', '.join(own)}, got {', '.join(map(str, found))}")
        for key, value in own.items():
            check_like(f"{name}.{key}", found[key], value)
    elif isinstance(own, (list, tuple)):
        if len(found) != len(own):
            raise ValueError(f"{name} must hold {len(own)} values, got {len(found)}")
        for place, value in enumerate(own):
            check_like(f"{name}.{place}", found[place], value)


def load_optimizer(optimizer: torch.optim.Optimizer, found: dict[str, Any]) -> None:
    """Load the state of an optimiser, Adam, for the same parameters; one it cannot use is refused.

    Options that another version of PyTorch has may be missing or more.
    """
    own = optimizer.state_dict()
    for group, saved in zip(own["param_groups"], found["param_groups"], strict=True):
        for key in {"params", "lr", *(group.keys() & saved.keys())}:
            check_like(f"optimizer.{key}", saved[key], group[key])
    parameters = [each for group in optimizer.param_groups for each in group["params"]]
    for place, saved in found["state"].items():
        like = parameters[checks.integer("optimizer", place, 0, len(parameters) - 1)]
        like_this = {"step": torch.zeros(()), "exp_avg": like, "exp_avg_sq": like}
        check_like(f"optimizer.{place}", saved, like_this)
    optimizer.load_state_dict(found)


def _check_hidden(card: PolicyCard, size: int) -> None:
    """Raise a ValueError if a file of this size [bytes] cannot fill the layers of the card."""
    if 4 * sum(card.hidden) + 4 * sum(a * b for a, b in pairwise(card.hidden)) > size:
        raise ValueError(f"hidden must be layers that {size} bytes fill, got {card.hidden}")


def _load_weights(network: torch.nn.Module, weights: dict[str, Any]) -> None:
    """Load finite weights of the network's own types, which PyTorch would convert otherwise."""
    for name, wanted in network.state_dict().items():
        check_tensor(name, weights[name], wanted)
    network.load_state_dict(weights)
