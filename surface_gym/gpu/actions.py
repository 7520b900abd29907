"""Actions that are tensors, as commands."""

import math
from typing import Any

import numpy as np
import torch
from gymnasium import spaces


class TensorActions:
    """Turns actions of all lanes into commands, as `ActionKind.commands` does.

    To look at numbers, the host would have to wait for the device. So a number out of range is
    noted, not raised at once: the lane gets the first choice, or 0 rad, and `wrong` tells.

    Args:
        space: of one lane's action, as an action kind gives it.
        lanes: their number.
        device: where the actions are.
    """

    def __init__(self, space: spaces.Space[Any], lanes: int, device: torch.device) -> None:
        self._shape = (lanes, *(space.shape or ()))
        # () whether a number was out of range
        self.wrong = torch.zeros((), dtype=torch.bool, device=device)
        self._angles = isinstance(space, spaces.Box)
        self._pairs = isinstance(space, spaces.Discrete)  # a number says two choices
        if isinstance(space, spaces.Box):
            self._right_angle = float(space.high.max())
            self.allowed = "-pi/2 and pi/2"
            return
        assert isinstance(space, spaces.Discrete | spaces.MultiDiscrete)
        most = np.asarray(space.n if isinstance(space, spaces.Discrete) else space.nvec)
        self._choices = torch.from_numpy(most.astype(np.int64)).to(device)
        self._side = math.isqrt(int(most.max()))
        self.allowed = f"0 and {int(most.max()) - 1}"

    def commands(self, actions: Any) -> torch.Tensor:
        """Actions as commands (lanes, size): choices, or angles [rad].

        Raises:
            ValueError: no tensor, on another device, of a wrong shape or kind of number.
        """
        device = self.wrong.device
        if not isinstance(actions, torch.Tensor):
            raise ValueError(f"action must be a torch tensor on {device}, got {type(actions)}")
        if actions.device.type != device.type:
            raise ValueError(f"action must be a tensor on {device}, got one on {actions.device}")
        if tuple(actions.shape) != self._shape:
            raise ValueError(
                f"action must have the shape {self._shape[1:]} a lane, "
                f"got {tuple(actions.shape)} of all"
            )
        return self._turned(actions) if self._angles else self._chosen(actions)

    def _turned(self, actions: torch.Tensor) -> torch.Tensor:
        if not actions.is_floating_point():
            raise ValueError(f"action must be angles, got {actions.dtype}")
        right = actions.abs() <= self._right_angle
        self.wrong |= ~right.all()
        return torch.where(right, actions, 0.0).to(torch.float64)

    def _chosen(self, actions: torch.Tensor) -> torch.Tensor:
        if actions.is_floating_point() or actions.is_complex() or actions.dtype == torch.bool:
            raise ValueError(f"action must be whole numbers, got {actions.dtype}")
        right = (actions >= 0) & (actions < self._choices)
        self.wrong |= ~right.all()
        chosen = torch.where(right, actions, 0).to(torch.int64)
        if not self._pairs:
            return chosen
        return torch.stack([chosen // self._side, chosen % self._side], dim=1)
