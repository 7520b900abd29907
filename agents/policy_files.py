"""A policy's files, read at one place and made use of at another."""

from dataclasses import dataclass
from pathlib import Path

from .policy_card import CARD

WEIGHTS = "policy.pt"


@dataclass(frozen=True)
class PolicyFiles:
    """What a policy's files hold; other machines need not see its folder."""

    folder: Path
    weights: bytes
    card: bytes


def read_files(folder: Path) -> PolicyFiles:
    """The files of a policy, as they are.

    Raises:
        ValueError: one is missing.
    """
    for name in (WEIGHTS, CARD):
        if not (folder / name).is_file():
            raise ValueError(f"{folder} holds no policy: {name} is missing")
    return PolicyFiles(folder, (folder / WEIGHTS).read_bytes(), (folder / CARD).read_bytes())
