"""`surface-gym design flow`: flags and their parsing."""

import json
import re
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

import surface_gym as sg
from surface_gym import checks, files, parallel

if TYPE_CHECKING:
    from surface_gym.design.report import Answer
    from surface_gym.design.runs import OnProgress

MIX = "S, B or LENGTHxWIDTH in m, with odds, as S=1,B=2,0.3x0.4"
EXITS = "sides, chutes, or a list as left:1.0-2.5,right:1.0-2.5,straight"
SPEEDS = (0.1, 20.0)  # [m/s]
_SPAN = re.compile(r"((?P<side>left|right)[^:]*):(?P<first>[^-:]+)-(?P<last>[^-:]+)")


@dataclass(frozen=True)
class AskFlow:
    """Find the shortest line and the fewest actuators for a rate of parcels."""

    rate: Annotated[float, tyro.conf.arg(metavar="PER_HOUR")]
    """Throughput in parcels per hour, each delivered to its own exit."""
    mix: Annotated[str, tyro.conf.arg(metavar="S=1,B=1")] = "S"
    """Parcels and their odds, e.g. "S=2,0.3x0.4=1": S and B are the study's boxes, others are
    length x width in m.
    """
    exits: Annotated[str, tyro.conf.arg(metavar="EXITS")] = "sides"
    """Exits with equal odds: sides, chutes, or a list of positions [m] from the line's entry, e.g.
    left:1.0-2.5,right:1.0-2.5,straight. Sides and chutes are as long as the line.
    """
    speed: Annotated[tuple[float, ...], tyro.conf.arg(metavar="SPEED [SPEED]")] = (1.5,)
    """Entry speed [m/s]: one number, or the smallest and the largest."""
    longest: float = 6.0
    """Longest line to try [m]."""

    workers: int = field(default_factory=parallel.usable_cores)
    """Number of processes; results do not depend on it."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/design")
    """Folder for the tables and the figure."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File for all numbers as JSON."""

    checkpoint = None  # no checkpoint, since the answer takes a minute
    assumed = remark = ""

    def check(self) -> Any:
        """Check all flags; return the `FlowCase`."""
        parallel.check_count("workers", self.workers)
        if len(self.speed) not in (1, 2):
            raise ValueError(f"speed must be one number or two, got {self.speed!r}")
        for each in self.speed:
            checks.positive("speed", each, *SPEEDS)
        if self.speed[0] > self.speed[-1]:
            raise ValueError(f"speed must be the least and then the greatest, got {self.speed!r}")
        speed = self.speed[0] if len(self.speed) == 1 else self.speed
        return import_module("surface_gym.agents.scheduling.design").FlowCase(
            self.rate, parse_mix(self.mix), parse_exits(self.exits), speed, self.longest
        )

    def answer(self, on_progress: "OnProgress") -> "Answer":
        """Find the answer."""
        found: Answer = import_module("surface_gym.agents.scheduling.design_report").answer_flow(
            self.check(), self.workers, on_progress
        )
        return found

    def write(self, answer: Any) -> list[Path]:
        """Write the answer as JSON if requested."""
        if self.json is None:
            return []
        text = json.dumps(answer.as_json(), indent=1) + "\n"
        self.json.write_text(text, encoding="utf-8")
        return [self.json]


def parse_mix(text: str) -> tuple[tuple[Any, float], ...]:
    """Parse parcels and their odds."""
    return tuple(_parcel(*part.partition("=")[::2], text) for part in text.split(","))


def _parcel(name: str, odds: str, text: str) -> tuple[Any, float]:
    name, sides = name.strip(), name.split("x")
    if name in ("S", "B"):
        parcel: Any = name
    elif len(sides) == 2:
        size = [files.parse_number("each part of mix", side) for side in sides]
        parcel = sg.Parcel(sg.Rectangle(*size))
    else:
        raise ValueError(f"mix must be {MIX}, got {text!r}")
    return parcel, files.parse_number("odds of mix", odds) if odds else 1.0


def parse_exits(text: str) -> Any:
    """Parse a preset's name, or a list of exits."""
    from surface_gym.flow.exits import EXITS as PRESETS, Exit, Exits

    if text in PRESETS:
        return text
    found = []
    for part in map(str.strip, text.split(",")):
        span = _SPAN.fullmatch(part)
        if part == "straight":
            found.append(Exit(part, 0))
        elif span is None:
            raise ValueError(f"exits must be {EXITS}, got {text!r}")
        else:
            first, last = (files.parse_number("each span of exits", span[x]) for x in (3, 4))
            try:
                found.append(Exit(span[1], 1 if span["side"] == "left" else -1, first, last))
            except ValueError as error:
                raise ValueError(f"exits must be {EXITS}, got {text!r}: {error}") from None
    return Exits(tuple(found))
