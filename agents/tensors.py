"""Tensors from files, with checks before use."""

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import IO, Any, TypeVar

import numpy as np
import torch

from surface_gym import checks
from surface_gym.files import check_archive

Network = TypeVar("Network", bound=torch.nn.Module)


def load_tensors(stream: IO[bytes], plain: int = 2**16) -> dict[str, Any]:
    """Load tensors and plain values by name from PyTorch's format; no code is executed.

    Plain values, which PyTorch reads slowly, have at most `plain` bytes; policies have 2000.
    Damaged files raise one of the errors in `DAMAGE`.
    """
    check_archive(stream, plain)
    stream.seek(0)
    found = torch.load(stream, map_location="cpu", weights_only=True)
    if not isinstance(found, dict):
        raise ValueError(f"it must hold tensors by name, got a {type(found).__name__}")
    return found


def check_tensor(name: str, found: Any, wanted: torch.Tensor) -> None:
    """Raise a ValueError unless a tensor is finite, with the type and shape of another."""
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
    """Raise a ValueError unless values have the names, types and shapes of others.

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
    """Load the state of an Adam optimiser for the same parameters, or raise an error.

    Options of other PyTorch versions may be missing or additional.
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
    """Make a network, and load finite weights of the same types, without conversion.

    Args:
        hidden: units of its layers, checked against the shapes of the weights first.
    """
    shapes = {value.shape for value in weights.values()}
    wanted = {(units, before) for before, units in pairwise(hidden)}
    if not wanted <= shapes or hidden[0] not in {shape[0] for shape in shapes if shape}:
        raise ValueError(f"hidden must be the units of the weights' layers, got {hidden}")
    network = make_network()
    tensors = {name: torch.from_numpy(np.array(value)) for name, value in weights.items()}
    for name, wanted in network.state_dict().items():
        check_tensor(name, tensors[name], wanted)
    network.load_state_dict(tensors)
    return network.eval()
