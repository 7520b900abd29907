"""Between host and device, so that neither waits for the other."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


class Note:
    """What a tensor holds now, to be read later: only then does the host wait for it."""

    def __init__(self, values: torch.Tensor) -> None:
        self._event: Any = None
        if values.is_cuda:
            self._event = torch.cuda.Event()  # type: ignore[no-untyped-call]
        self._values = torch.empty(values.shape, dtype=values.dtype, pin_memory=values.is_cuda)
        self._values.copy_(values, non_blocking=True)
        if self._event is not None:
            self._event.record()

    def read(self) -> NDArray[Any]:
        """The values, an array of one's own."""
        if self._event is not None:
            self._event.synchronize()
        values: NDArray[Any] = self._values.numpy().copy()
        return values


def sent(values: NDArray[Any], device: torch.device) -> torch.Tensor:
    """An array on a device, on its way there while the host goes on."""
    copy = torch.from_numpy(np.array(values))
    return (copy.pin_memory() if device.type == "cuda" else copy).to(device, non_blocking=True)
