"""A file that keeps how far a search has come."""

from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from surface_gym.whole_files import replacing

COUNTS = ("epoch", "column", "unchanged", "evaluations")
ARRAYS = ("population", "cost")


def write_progress(file: Path, told: str, progress: dict[str, Any]) -> None:
    """Keep how far it is; a write that is broken off leaves the file as it was.

    Args:
        file: to write.
        told: what the search is of.
        progress: `search.Progress`, field by field.
    """
    with replacing(file) as part, part.open("wb") as stream:
        np.savez(stream, told=told, **progress)


def read_progress(file: Path, told: str) -> dict[str, Any]:
    """What `write_progress` has kept.

    Raises:
        ValueError: it is no such file, or of another search than is told.
    """
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
            its = str(kept["told"])
            found: dict[str, Any] = {name: int(kept[name]) for name in COUNTS}
            found |= {name: kept[name].astype(np.float64) for name in ARRAYS}
    except (BadZipFile, EOFError, KeyError, TypeError, ValueError, AttributeError):
        raise ValueError(f"checkpoint must be one of a search, got {file}") from None
    if its != told:
        raise ValueError(f"checkpoint must be of this search, {told}, got {file} of {its}")
    return found
