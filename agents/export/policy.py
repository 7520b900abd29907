"""A policy to export: its training, and its network and decision as plain arrays.
A decision has a choice, the index of an angle, for each part of the action.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from surface_gym import checks
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.files import DAMAGE, describe_damage
from surface_gym.tasks import Task

from .. import library
from ..base import SIDE, Booleans, Integers, Numbers, Singles
from ..evaluation.method import policy_folders
from ..learning import runs
from ..learning.config import NOMINAL
from ..module_policy import ModulePolicy
from ..policy import Policy, make_network

# Presets of the environments that agents were trained in, by `train.py --preset`.
TRAINED_IN: dict[str, tuple[str, ...]] = {NOMINAL: ("exact", "camera"), "lab": ("exact", "lab")}
ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", nn.ReLU: "relu"}


@dataclass(frozen=True, eq=False)
class Training:
    """The training of an agent, as the card in the agent's folder describes it."""

    preset: str  # preset of the training
    command: str | None = None  # training command; None: unknown
    results: tuple[tuple[str, float], ...] = ()  # [-] success rate by preset; empty: unknown

    @property
    def presets(self) -> tuple[Preset, ...]:
        """Presets of the training environments."""
        names = TRAINED_IN.get(self.preset, (self.preset,))
        return tuple(PRESETS[checks.one_of("preset", name, PRESETS)] for name in names)


@dataclass(frozen=True, eq=False)
class Source:
    """A policy to export, with its environment's configuration and its training."""

    name: str
    seed: int
    policy: Policy | ModulePolicy
    config: EnvConfig  # of the policy's environment
    weights: dict[str, torch.Tensor]
    digest: str  # of card and weights
    training: Training


def shipped(name: str, seed: int | None = None) -> Source:
    """Return a shipped agent's policy. The default seed is the agent's first seed."""
    seeds = library.seeds(name)
    chosen = seeds[0] if seed is None else int(checks.one_of("seed", seed, seeds))
    folder = library.SHELF / name
    return _read(name, chosen, folder / f"seed-{chosen}", None, _read_training(folder))


def of_run(
    run: Path, name: str | None = None, seed: int | None = None, task: str | None = None
) -> Source:
    """Return a policy from a training run's folder `run`. The default is the run's first seed."""
    folders = policy_folders(run)
    chosen = next(iter(folders)) if seed is None else int(checks.one_of("seed", seed, folders))
    custom = None if task is None else library.find_task(task)
    training = _read_training(run)
    if training is None and (run / runs.CONFIG).is_file():
        training = Training(runs.read_config(run / runs.CONFIG, task).preset)
    return _read(name or run.resolve().name, chosen, folders[chosen], custom, training)


def _read(
    name: str, seed: int, folder: Path, task: Task | None, training: Training | None
) -> Source:
    files = library.read_files(folder)
    policy = library.from_files(files, task)
    if not isinstance(policy, (Policy, ModulePolicy)):
        raise ValueError(
            f"name must be an agent of single parcels (PPO, DQN or modules), got {name!r}: "
            "in a stream of parcels the environment decides which module follows which parcel"
        )
    return Source(
        name,
        seed,
        policy,
        policy.card.env_config(task),
        {name: torch.from_numpy(each) for name, each in library.read_weights(files).items()},
        str(library.parse_yaml(files.card.decode())[library.DIGEST]),
        training or Training(NOMINAL),
    )


def _read_training(folder: Path) -> Training | None:
    """Read the training from the card in a folder. Return None if there is no card."""
    file = folder / runs.CARD
    try:
        card = library.read_yaml(file)
        command = card["command"]
        if not isinstance(command, str):
            raise ValueError(f"command must be text, got {command!r:.60}")
        words = shlex.split(command)
        asked = words[words.index("--preset") + 1] if "--preset" in words else NOMINAL
        results = tuple(
            (name, checks.within(f"success of {name}", found["success"], 0.0, 1.0))
            for name, found in card["results"].items()
            if "success" in found
        )
        training = Training(str(card.get("preset", asked)), command, results)
        _ = training.presets  # names those that there are
        return training
    except FileNotFoundError:
        return None
    except DAMAGE as error:
        raise ValueError(f"{file} is no run's card: {describe_damage(error)}") from None


@dataclass(frozen=True, eq=False)
class Layer:
    """A linear layer: weights times inputs, plus the bias."""

    weights: Singles  # (outputs, inputs)
    bias: Singles  # (outputs,)


@dataclass(frozen=True, eq=False)
class Network:
    """Linear layers in sequence. The same activation follows every layer except the last."""

    layers: tuple[Layer, ...]
    activation: str  # "tanh" or "relu"

    def scores(self, inputs: Numbers) -> Numbers:
        """Compute the outputs (..., outputs) for inputs (..., inputs), in float64."""
        values = inputs
        for k, layer in enumerate(self.layers):
            if k:
                values = np.tanh(values) if self.activation == "tanh" else np.maximum(values, 0.0)
            values = values @ layer.weights.T.astype(np.float64) + layer.bias
        return values


def read_network(modules: nn.Module) -> Network:
    """Read a `Network` from PyTorch modules. Raise a ValueError for modules of other kinds."""
    leaves = [each for each in modules.modules() if not list(each.children())]
    linear, between = leaves[::2], leaves[1::2]
    kinds = {type(each) for each in between}
    if (
        len(linear) != len(between) + 1
        or not all(isinstance(each, nn.Linear) for each in linear)
        or len(kinds) != 1
        or not kinds <= set(ACTIVATIONS)
    ):
        raise ValueError(
            "network must be linear layers with Tanh, or with ReLU, between each two, to be "
            f"exported, got {', '.join(type(each).__name__ for each in leaves)}"
        )
    layers = tuple(
        Layer(*(np.array(part.detach().numpy()) for part in (each.weight, each.bias)))
        for each in linear
        if isinstance(each, nn.Linear)
    )
    return Network(layers, ACTIVATIONS[kinds.pop()])


def are_close(scores: Numbers, tie: float) -> Booleans:
    """Return booleans (...): whether the best two of the scores (..., options) are a tie.

    Two scores are a tie if their difference is at most `tie` times the largest absolute score. If
    the largest absolute score is below 1, the limit is `tie`.
    """
    best = np.sort(scores, axis=-1)
    scale = np.maximum(1.0, np.abs(scores).max(axis=-1))
    return best[..., -1] - best[..., -2] <= tie * scale


@dataclass(frozen=True, eq=False)
class Symmetry:
    """How to mirror choices if the goal is at y < 0. The network always chooses for y > 0."""

    side: int  # index of the side in the observation
    images: Integers  # (choices,) the mirror image of each orientation
    parts: Integers  # (parts,) the mirror image of each part


@dataclass(frozen=True, eq=False)
class NetworkDecision:
    """Decision of a PPO or DQN policy.

    The parts of the action form groups. An option has one choice for each part of a group. The
    network scores the options of each group, and the best option is taken.
    """

    network: Network
    options: Integers  # (options, parts of a group) choices of each option
    groups: int  # number of groups
    angles: tuple[float, ...]  # [rad] angle of each choice
    symmetry: Symmetry | None  # None: the task is not mirrored

    @property
    def features(self) -> int:
        return int(self.network.layers[0].weights.shape[1])

    @property
    def parts(self) -> int:
        return self.groups * self.options.shape[1]

    def in_doubt(self, observations: Singles, tie: float) -> Booleans:
        """Return a mask (count, parts) of the choices whose best two options tie (`are_close`)."""
        scores = self.network.scores(observations.astype(np.float64))
        close = are_close(scores.reshape(len(observations), self.groups, -1), tie)
        parts = close.repeat(self.options.shape[1], axis=1)
        if self.symmetry is None:
            return parts
        mirrored = observations[:, self.symmetry.side : self.symmetry.side + 1] < 0.0
        return np.where(mirrored, parts[:, self.symmetry.parts], parts)


def network_decision(source: Source) -> NetworkDecision:
    """Read a PPO or DQN policy's decision. If a policy cannot be exported, raise a ValueError."""
    config, card = source.config, source.policy.card
    kind = config.action_kind
    if kind.continuous:
        raise ValueError("orientations must be some to choose from, to be exported, got any angle")
    module = make_network(card, config)
    module.load_state_dict(source.weights)
    if card.algo == "dqn":
        network = read_network(module.get_submodule("q_net.q_net"))
    else:
        hidden = module.get_submodule("mlp_extractor.policy_net")
        network = read_network(nn.Sequential(hidden, module.get_submodule("action_net")))
    orientations, symmetry = config.chosen_orientations, None
    if config.task.mirrored:  # a goal at y < 0 is observed in a mirror
        parts = kind.flip(np.arange(kind.size)[np.newaxis])[0]
        symmetry = Symmetry(SIDE, config.images, parts)
    if kind.space().shape == ():  # one choice for all parts
        count = len(network.layers[-1].bias)
        options, groups = kind.commands(np.arange(count), count), 1
    else:
        options, groups = np.arange(kind.choices)[:, np.newaxis], kind.size
    return NetworkDecision(network, options, groups, orientations, symmetry)
