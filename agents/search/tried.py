"""What came of a trial, and the file that keeps all of them."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from surface_gym import checks
from surface_gym.whole_files import replacing

FILE = "trials.jsonl"
COMPLETE = "complete"
PRUNED = "pruned"
REFUSED = "refused"  # a configuration that is not allowed
FAILED = "failed"  # learning broke down, by numbers that are none
STATES = (COMPLETE, PRUNED, REFUSED, FAILED)


@dataclass(frozen=True)
class Tried:
    """What came of a trial."""

    number: int
    params: dict[str, Any]  # value of each name that is searched, as JSON has it
    state: str
    value: float | None  # of a complete trial
    intermediate: dict[int, float]  # value on the way, by the number of the look, from 1
    rungs: dict[str, float]  # what the pruner noted of it
    why: str  # it was refused or failed
    seconds: float  # it took


def write_tried(trials: Iterable[Tried], folder: Path) -> None:
    """Keep trials in a folder, a line each by their numbers; whole, or as it was before."""
    lines = [json.dumps(asdict(tried)) for tried in sorted(trials, key=lambda each: each.number)]
    with replacing(folder / FILE) as part:
        part.write_text("".join(f"{line}\n" for line in lines))


def read_tried(folder: Path) -> dict[int, Tried]:
    """The trials that are kept in a folder, by number; none where there is no file.

    Raises:
        ValueError: it is damaged.
    """
    file = folder / FILE
    if not file.is_file():
        return {}
    try:
        found = [_tried(**json.loads(line)) for line in file.read_text().splitlines()]
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{file} is damaged: {error}") from None
    return {tried.number: tried for tried in found}


def best_of(trials: Iterable[Tried]) -> Tried | None:
    """The complete trial of the highest value, the earliest of equals; None where there is none."""
    complete = [(tried.value, -tried.number, tried) for tried in trials if tried.value is not None]
    return max(complete, key=lambda each: each[:2])[-1] if complete else None


def _tried(intermediate: dict[str, float], **others: Any) -> Tried:
    tried = Tried(intermediate={int(look): value for look, value in intermediate.items()}, **others)
    checks.one_of("state", tried.state, STATES)
    if (tried.value is None) == (tried.state == COMPLETE):
        raise ValueError(f"a value must be there of complete trials alone, got {tried.value!r}")
    return tried
