"""A rule with what it is for."""

from collections.abc import Callable
from dataclasses import dataclass

from surface_gym.settings import Settings

from ..controller import Controller


@dataclass(frozen=True)
class Rule:
    """A controller that does not learn."""

    name: str
    task: str  # its name
    actions: str  # the kind of action it is for
    make: Callable[[Settings], Controller]
    observe: tuple[str, ...] = ()  # groups of features it makes use of, where they are shown
