"""`agents.mirror.ActionMirror` on tensors."""

import numpy as np
import torch
from gymnasium import spaces

from surface_gym.settings import Settings

from ...mirror import ActionMirror, mirrored_orientations


class TensorMirror:
    """Turns actions chosen for y > 0 into those for y < 0.

    Args:
        settings: of the environment; its actions are choices.
        device: of the actions.
    """

    def __init__(self, settings: Settings, device: torch.device) -> None:
        kind, orientations = settings.action_kind, settings.chosen_orientations
        space = kind.space()
        if isinstance(space, spaces.Discrete):
            every = np.arange(space.n)
            images = ActionMirror(kind, orientations)(every, -np.ones(len(every), np.float32))
            places = np.zeros(1, dtype=np.int64)
        else:
            images = mirrored_orientations(orientations)
            places = kind.flip(np.arange(kind.size)[np.newaxis])[0]
        self._images = torch.from_numpy(images).to(device)  # (options,) each choice's
        self._places = torch.from_numpy(places).to(device)  # (parts,) whose choice a part gets

    def __call__(self, actions: torch.Tensor, side: torch.Tensor) -> torch.Tensor:
        """Actions (lanes, ...) in the world, for the asked side (lanes,) of each lane."""
        parts = actions.reshape(len(actions), -1)
        images = self._images[parts[:, self._places]]
        # Straight through, side 0, is seen as it is.
        return torch.where((side >= 0.0).unsqueeze(1), parts, images).reshape(actions.shape)
