"""The cluster that work is handed to, and what every node must have."""

import hashlib
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from surface_gym.find_agents import agents_name
from surface_gym.sharing.crew import WorkFailed

POLICY_FILES = (".pt", ".yaml")


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster that this machine belongs to.

    Raises:
        ValueError: the address is empty, or one of Ray's client.
    """

    address: str
    """host:port of its head, or "auto" for the one this machine belongs to."""
    files: tuple[Path, ...] = ()
    """Below the working folder, which the nodes need: tasks of one's own."""

    def __post_init__(self) -> None:
        if not self.address or self.address.startswith("ray://"):
            raise ValueError(
                "cluster must be host:port, or auto, of a cluster that this machine has joined by "
                f"`ray start --address=...`, got {self.address!r}"
            )


@dataclass(frozen=True)
class Build:
    """What of the package a node has."""

    version: str
    code: str  # digest of the sources
    policies: str  # digest of the policies that ship

    def __str__(self) -> str:
        return f"version {self.version} (code {self.code}, policies {self.policies})"


@lru_cache(maxsize=1)
def own_build() -> Build:
    """What this process has."""
    from surface_gym import __version__

    return Build(__version__, _digest((".py", ".yml", ".json")), _digest(POLICY_FILES))


def check_build(wanted: Build) -> None:
    """Refuse work from whoever has another version than this process.

    Raises:
        WorkFailed: it differs; both are named.
    """
    if own_build() != wanted:
        raise WorkFailed(
            f"the node {socket.gethostname()} has surface_gym {own_build()}, whoever hands out the "
            f"work {wanted}: install the same on both"
        )


def _digest(endings: tuple[str, ...]) -> str:
    total = hashlib.sha256()
    for name, file in _files():
        if file.suffix in endings:
            total.update(f"{name} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    return total.hexdigest()[:8]


def _files() -> Iterator[tuple[str, Path]]:
    """Files of the packages, by a name that is the same on all machines."""
    for package in dict.fromkeys(("surface_gym", agents_name().partition(".")[0])):
        found = find_spec(package)
        for place in found.submodule_search_locations or () if found is not None else ():
            root = Path(place)
            for file in sorted(root.rglob("*")):
                yield f"{package}/{file.relative_to(root).as_posix()}", file
