"""What every kind of sensor has in common."""

from typing import NamedTuple, Protocol

from surface_gym.dynamics.types import Array


class Sensing(NamedTuple):
    """A kind of sensor as compiled code reads it."""

    number: int  # its place in `sensors.reading`
    settings: Array  # (settings,) the kind says what each holds


class Sensors(Protocol):
    """What the environment asks of a kind of sensor."""

    def sensing(self, dt: float) -> Sensing:
        """The sensor as compiled code reads it, for physics steps of `dt` [s]."""

    def draws(self, dt: float, steps: int) -> int:
        """Rows of noise that `steps` physics steps use at most."""
