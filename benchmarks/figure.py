"""A figure and what is asked of it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A measured figure beside the one asked for."""

    name: str
    value: float
    unit: str
    most: float | None = None  # asked for, at most
    least: float | None = None  # asked for, at least

    @property
    def asked(self) -> str:
        """The bound in words."""
        if self.most is not None:
            return f"<= {self.most:g}"
        return f">= {self.least:g}" if self.least is not None else ""
