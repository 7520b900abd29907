"""A run's state on disk, so that a run broken off goes on as if it had not been.

Written whole or not at all. It holds tensors and plain values only: reading it runs no code.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer

from surface_gym.whole_files import replacing

from ..damage import DAMAGE, told
from .double_dqn import DoubleDQN
from .model import Model

Restored = TypeVar("Restored")

FILE = "checkpoint.pt"
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
_REMEMBERED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save_checkpoint(model: Model, recent: list[dict[str, float]], folder: Path) -> None:
    """Write networks, optimiser, counters, memory and the latest episodes into a folder."""
    state: dict[str, Any] = {
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "counters": {name: getattr(model, name) for name in _COUNTERS},
        "recent": recent,
    }
    if isinstance(model, DoubleDQN):
        state["calls"] = model._n_calls
        state["memory"] = _memory(model)
    write_state(state, folder)


def load_checkpoint(model: Model, folder: Path) -> list[dict[str, float]]:
    """Bring a model made from the run's configuration to the checkpoint; the latest episodes.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration.
    """

    def restore(state: dict[str, Any]) -> list[dict[str, float]]:
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
        for name in _COUNTERS:
            setattr(model, name, int(state["counters"][name]))
        if isinstance(model, DoubleDQN):
            model._n_calls = int(state["calls"])
            _remember(model, state["memory"])
        recent: list[dict[str, float]] = state["recent"]
        return recent

    return read_state(folder, restore)


def write_state(state: dict[str, Any], folder: Path) -> None:
    """Write tensors and plain values as a folder's checkpoint, whole or not at all."""
    with replacing(folder / FILE) as part, part.open("wb") as file:
        torch.save(state, file)
        file.flush()
        os.fsync(file.fileno())


def read_state(folder: Path, restore: Callable[[dict[str, Any]], Restored]) -> Restored:
    """Hand what `write_state` wrote to `restore`, and its answer back.

    Raises:
        ValueError: the checkpoint is damaged, or `restore` could not make use of it.
    """
    try:
        return restore(torch.load(folder / FILE, map_location="cpu", weights_only=True))
    except DAMAGE as error:
        raise ValueError(f"{folder / FILE} is damaged or of another run: {told(error)}") from None


def _buffer(model: DoubleDQN) -> ReplayBuffer:
    assert model.replay_buffer is not None
    return model.replay_buffer


def _memory(model: DoubleDQN) -> dict[str, Any]:
    buffer = _buffer(model)
    filled = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {name: torch.from_numpy(getattr(buffer, name)[:filled]) for name in _REMEMBERED}
    return {"pos": buffer.pos, "full": buffer.full, "arrays": arrays}


def _remember(model: DoubleDQN, memory: dict[str, Any]) -> None:
    buffer = _buffer(model)
    buffer.pos, buffer.full = int(memory["pos"]), bool(memory["full"])
    for name in _REMEMBERED:
        values: np.ndarray[Any, Any] = memory["arrays"][name].numpy()
        getattr(buffer, name)[: len(values)] = values
