"""Actions that are tensors, as commands."""

import torch

from surface_gym.actions.kinds import RIGHT_ANGLE, ActionKind


class TensorActions:
    """Turns actions of all lanes into commands, as `ActionKind.commands` does.

    To look at numbers, the host would have to wait for the device. So a number out of range is
    noted, not raised at once: the lane gets the first choice, or 0 rad, and `wrong` tells.

    Args:
        kind: of action.
        lanes: their number.
        device: where the actions are.
    """

    def __init__(self, kind: ActionKind, lanes: int, device: torch.device) -> None:
        self._kind = kind
        single = kind.name == "halves" and not kind.continuous
        self._shape = (lanes,) if single else (lanes, kind.size)
        self._choices = kind.choices**2 if single else kind.choices
        self._single = single
        self.allowed = "-pi/2 and pi/2" if kind.continuous else f"0 and {self._choices - 1}"
        # () whether a number was out of range
        self.wrong = torch.zeros((), dtype=torch.bool, device=device)

    def commands(self, actions: torch.Tensor) -> torch.Tensor:
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
                f"action must have the shape {self._shape[1:]} a lane, got {tuple(actions.shape)}"
            )
        return self._angles(actions) if self._kind.continuous else self._chosen(actions)

    def _angles(self, actions: torch.Tensor) -> torch.Tensor:
        if not actions.is_floating_point():
            raise ValueError(f"action must be angles, got {actions.dtype}")
        right = actions.abs() <= float(RIGHT_ANGLE)
        self.wrong |= ~right.all()
        return torch.where(right, actions, 0.0).to(torch.float64)

    def _chosen(self, actions: torch.Tensor) -> torch.Tensor:
        if actions.is_floating_point() or actions.is_complex() or actions.dtype == torch.bool:
            raise ValueError(f"action must be whole numbers, got {actions.dtype}")
        right = (actions >= 0) & (actions < self._choices)
        self.wrong |= ~right.all()
        chosen = torch.where(right, actions, 0).to(torch.int64)
        if not self._single:
            return chosen
        choices = self._kind.choices
        return torch.stack([chosen // choices, chosen % choices], dim=1)
