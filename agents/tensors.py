"""Common parts of networks: layers, joint draws of modules, and checked tensors from files.

There are 6 to 25 modules under a parcel. With independent draws, their deviations would cancel, and
exploration would have no effect. Instead, the modules of a group look up one uniform number in
their own cumulative probabilities. Similar modules choose alike, and each follows its own
probabilities. The likelihood of a group's choices has a closed form: the length of the interval of
uniform numbers that give these choices.
"""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import IO, Any, TypeVar

import numpy as np
import torch
from torch import nn

from surface_gym import checks
from surface_gym.files import check_archive

from .base import Integers, Singles

Network = TypeVar("Network", bound=nn.Module)


def load_tensors(stream: IO[bytes], plain: int = 2**16) -> dict[str, Any]:
    """Load tensors and plain values by name from a stream in PyTorch's format.

    No code in the stream is executed. A damaged stream raises one of the errors in `DAMAGE`. Plain
    values may have at most `plain` bytes, since PyTorch reads them slowly.
    """
    check_archive(stream, plain)
    stream.seek(0)
    found = torch.load(stream, map_location="cpu", weights_only=True)
    if not isinstance(found, dict):
        raise ValueError(f"it must hold tensors by name, got a {type(found).__name__}")
    return found


def check_tensor(name: str, found: Any, wanted: torch.Tensor) -> None:
    """Raise a ValueError unless `found` is a finite tensor with the type and shape of `wanted`."""
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
    """Raise a ValueError unless nested values `found` have the names, types and shapes of `own`.

    Numbers must be finite, and integers at least 0.
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
    """Load the state `found` into an Adam optimizer. If the state does not fit, raise an error.

    The state may come from another PyTorch version, with more or fewer options.
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


def load_weights(
    make_network: Callable[[], Network], hidden: tuple[int, ...], weights: Mapping[str, Any]
) -> Network:
    """Make a network, and load its weights. If the weights do not fit, raise a ValueError.

    `hidden` holds the units of the network's layers, which must agree with the weights. PyTorch
    gets one thread, since more threads would only wait for each other.
    """
    shapes = {value.shape for value in weights.values()}
    wanted = {(units, before) for before, units in pairwise(hidden)}
    if not wanted <= shapes or hidden[0] not in {shape[0] for shape in shapes if shape}:
        raise ValueError(f"hidden must be the units of the weights' layers, got {hidden}")
    torch.set_num_threads(1)
    network = make_network()
    tensors = {name: torch.from_numpy(np.array(value)) for name, value in weights.items()}
    for name, wanted in network.state_dict().items():
        check_tensor(name, tensors[name], wanted)
    network.load_state_dict(tensors)
    return network.eval()


GROUPS = 2  # groups of modules per environment
_SMALLEST = 1e-6  # shorter intervals count as empty in single precision
# maximum distance of a line between groups from the parcel's centre, in half lengths
_FARTHEST = 0.7


def draw_groups(
    env: Integers, place: Singles, num_envs: int, probability: float, rng: np.random.Generator
) -> Integers:
    """Draw the group (modules,) of each module. The groups of environment i are 2 i and 2 i + 1.

    Args:
        env: (modules,) environment of each module.
        place: (modules, 2 or more) positions along and across the parcel, in half lengths.
        probability: probability that a random line splits a parcel's modules into two groups.
    """
    splits = rng.random(num_envs) < probability
    angle = 2.0 * np.pi * rng.random(num_envs)
    distance = rng.uniform(-_FARTHEST, _FARTHEST, num_envs)
    across = np.cos(angle)[env] * place[:, 0] + np.sin(angle)[env] * place[:, 1]
    return GROUPS * env + (splits[env] & (across > distance[env]))


def draw_choices(
    log_probability: torch.Tensor, group: torch.Tensor, uniform: torch.Tensor
) -> torch.Tensor:
    """Draw choices (modules,). All modules of a group use the same random number in `uniform`."""
    edges = log_probability.exp().cumsum(dim=1)[:, :-1]
    return (uniform[group].unsqueeze(1) > edges).sum(dim=1)


def log_likelihood(
    log_probability: torch.Tensor, choice: torch.Tensor, group: torch.Tensor, groups: int
) -> torch.Tensor:
    """Compute the joint log likelihood (num_envs,) of each environment's choices (modules,).

    The array `group` (modules,) is the result of `draw_groups`. `groups` is the number of groups,
    including groups without modules. The result is 0 for an environment without modules. All
    choices of a group are drawn by one uniform random number. If no number leads to the choices of
    a group, the group adds a constant minimum to the result, but no gradient.
    """
    edges = log_probability.exp().cumsum(dim=1)[:, :-1]
    below = nn.functional.pad(edges, (1, 0), value=0.0).gather(1, choice.unsqueeze(1))
    above = nn.functional.pad(edges, (0, 1), value=1.0).gather(1, choice.unsqueeze(1))
    first = below.new_zeros(groups).scatter_reduce(0, group, below.squeeze(1), "amax")
    last = above.new_ones(groups).scatter_reduce(0, group, above.squeeze(1), "amin")
    return (last - first).clamp(min=_SMALLEST).log().reshape(-1, GROUPS).sum(dim=1)


def make_linear(inputs: int, outputs: int, gain: float = math.sqrt(2.0)) -> nn.Linear:
    """Make a layer with orthogonal weights, scaled by `gain`, as Stable-Baselines3 does."""
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def make_layers(units: tuple[int, ...]) -> list[nn.Module]:
    """Make linear layers with the given numbers of units, each followed by tanh."""
    return [layer for sizes in pairwise(units) for layer in (make_linear(*sizes), nn.Tanh())]


class SharedNetwork(nn.Module):
    """An actor that all modules use. It computes logits from shared features and a module's place.

    The weights of the features of the place start at zero. So modules learn to act together before
    they learn to differ. With other initial weights, training converges to the fixed layout.
    `shared` and `place` are numbers of features. `hidden` holds the number of units of each hidden
    layer.
    """

    def __init__(self, shared: int, place: int, hidden: tuple[int, ...], choices: int) -> None:
        super().__init__()
        # Files of weights contain these names.
        self._alike = make_linear(shared, hidden[0])
        self._apart = nn.Linear(place, hidden[0], bias=False)
        nn.init.zeros_(self._apart.weight)
        self._between = nn.Sequential(*make_layers(hidden))
        self._logits = make_linear(hidden[-1], choices, 0.01)

    def log_probability(
        self, shared: torch.Tensor, env: torch.Tensor, place: torch.Tensor
    ) -> torch.Tensor:
        """Compute log probabilities (modules, choices) of the modules' choices.

        `env` (modules,) holds each module's environment. The array `shared` (num_envs, features)
        describes the environments. The array `place` (modules, features) describes the modules.
        """
        first = torch.tanh(self._alike(shared)[env] + self._apart(place))
        logits: torch.Tensor = self._logits(self._between(first))
        return logits.log_softmax(dim=1)
