"""The clock that the loop lives by: the machine's, or one that a test turns."""

import time
from typing import Protocol


class Clock(Protocol):
    """Tells the time and waits."""

    def now(self) -> float:
        """[s] since some moment; never back."""

    def sleep_until(self, moment: float) -> None:
        """Wait until then [s]; not at all where it has passed."""


class WallClock:
    """The machine's, `time.monotonic()`."""

    def now(self) -> float:
        """[s] since some moment."""
        return time.monotonic()

    def sleep_until(self, moment: float) -> None:
        """Wait until then [s]."""
        left = moment - time.monotonic()
        if left > 0.0:
            time.sleep(left)
