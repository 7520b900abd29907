"""A device whose messages are logged."""

from collections.abc import Callable

from surface_gym.lines import Site
from surface_gym.machine.log import LogWriter
from surface_gym.parcel import Parcel

from .protocol import Angles, Device, Message, ParcelEntry, axes_to_fields, to_fields


class LoggedDevice:
    """A `Device` that writes all messages of another device to a log.

    Args:
        device: the other device.
        log: where to write; its owner closes it.
        site_of: returns the rotors and the zone for a parcel.
        now: clock [s] of the messages.
    """

    def __init__(
        self,
        device: Device,
        log: LogWriter,
        site_of: Callable[[Parcel], Site],
        now: Callable[[], float],
    ) -> None:
        self._device, self._log, self._site_of, self._now = device, log, site_of, now

    def connect(self) -> None:
        self._device.connect()

    def close(self) -> None:
        self._device.close()

    def read(self) -> list[Message]:
        messages, passed = self._device.read(), self._now()
        for message in messages:
            if isinstance(message, ParcelEntry):
                self._log.write_site(passed, self._site_of(message.parcel))
            self._log.write(passed, "in", to_fields(message))
        return messages

    def set_axes(self, angles: Angles) -> int:
        number = self._device.set_axes(angles)
        self._log.write(self._now(), "out", axes_to_fields(number, angles))
        return number
