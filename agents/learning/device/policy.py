"""The policy as it learns on a device."""

from typing import Any

from gymnasium import spaces

from ...policies.categorical import EqualCategoricals, EqualChoicesPolicy


class DevicePolicy(EqualChoicesPolicy):
    """`EqualChoicesPolicy` that draws a single choice as it draws many: PyTorch's own draw checks
    its odds on the host, which would wait for the device at every control period.

    Likelihoods are asked for actions (lanes, choices). Parameters are named and shaped as there.
    """

    def _build(self, lr_schedule: Any) -> None:
        if isinstance(self.action_space, spaces.Discrete):
            self.action_dist = EqualCategoricals(1, int(self.action_space.n))
        super()._build(lr_schedule)
