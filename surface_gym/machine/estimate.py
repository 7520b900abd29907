"""Estimates of a surface, from `identify`."""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from surface_gym import checks, files
from surface_gym.config import Preset
from surface_gym.lines import BaseLine
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import AdaptiveCamera

VERSION = 1  # of the file's format
MAX_BYTES = 2**20  # of an estimate's file
FRICTIONS = ("mu_max", "mu_min", "mu_support")
MOST_SPREAD = 0.5  # [-] of friction in a preset


@dataclass(frozen=True)
class Estimate:
    """Parameters of a surface with 95 % intervals, and how far to trust them."""

    values: dict[str, float]  # by name, in the units of `PARAMETERS`
    intervals: dict[str, tuple[float, float]]  # 95 %; infinite if the logs cannot tell
    correlations: tuple[tuple[float, ...], ...]  # [-] of the errors of `correlated`
    correlated: tuple[str, ...]
    inseparable: tuple[tuple[str, ...], ...]  # parameters that the logs only tell together
    unknown: tuple[str, ...]  # parameters with too little effect on the logs
    misfit: float  # [-] chi^2 over its degrees of freedom: 1 if the model explains the pictures
    is_explained: bool  # whether chance explains a misfit above 1
    misfits: tuple[float, ...]  # [-] of each run
    frames: int  # number of pictures
    noise: tuple[float, float]  # [m, rad] standard deviation of the pictures
    delay: float = 0.0  # [s] median time from a picture's stated time to its message
    unused: dict[str, int] = field(default_factory=dict)  # number of other runs by reason

    def is_determined(self, name: str) -> bool:
        """Return whether the logs tell a parameter."""
        return name in self.intervals and math.isfinite(self.intervals[name][0])

    def line(self, line: BaseLine) -> BaseLine:
        """Return an environment's line with the identified friction."""
        for name in filter(self.is_determined, FRICTIONS):
            line = _with(line, name, self.values[name])
        return line

    def preset(self, name: str = "identified") -> Preset:
        """Return a preset for environments: noise, delay, turning axes, and doubt about friction.

        Give it beside `line`, and the tilt to the task.
        """
        speed = math.inf
        if self.is_determined("quarter_turn"):
            speed = 0.5 * math.pi / max(self.values["quarter_turn"], 1e-3)
        stale = self.values["latency"] if self.is_determined("latency") else 0.0
        return Preset(
            name,
            name,
            f"The machine of {len(self.misfits)} logged runs.",
            sensors=AdaptiveCamera(
                latency=max(0.0, self.delay + stale),
                position_noise=self.noise[0],
                angle_noise=self.noise[1],
            ),
            actuators=Actuators(axis_speed=speed),
            randomisation=Randomisation(
                friction=self._spread("mu_max"),
                rolling=max(self._spread("mu_min"), self._spread("mu_support")),
            ),
        )

    def _spread(self, name: str) -> float:
        """Return half an interval as a share of the value."""
        if not self.is_determined(name):
            return 0.0
        low, high = self.intervals[name]
        value = self.values[name]
        return min(MOST_SPREAD, 0.5 * (high - low) / value) if value > 0.0 else MOST_SPREAD

    def warnings(self) -> Iterator[str]:
        """Yield what the logs do not tell, in sentences."""
        if not self.is_explained:
            yield (
                f"The model does not explain the pictures: misfit {self.misfit:.2f}. Something "
                "acts that it lacks, e.g. uneven supports, stuck modules or a moving load."
            )
        for group in self.inseparable:
            yield f"The logs do not separate {' and '.join(group)}."
        for name in self.unknown:
            yield f"The logs do not tell {name}."
        for reason, count in self.unused.items():
            yield f"Runs that are not used: {count}, {reason}."

    def save(self, file: str | Path) -> None:
        """Write the estimate as JSON; an infinite end of an interval becomes null."""
        content = {"kind": "estimate", "version": VERSION, **asdict(self)}
        ends = {name: [_or_none(end) for end in pair] for name, pair in self.intervals.items()}
        with files.replacing(Path(file)) as part:
            part.write_text(json.dumps({**content, "intervals": ends}, indent=1, allow_nan=False))

    @classmethod
    def load(cls, file: str | Path) -> "Estimate":
        """Read an estimate.

        Raises:
            ValueError: the file is no estimate.
            FileNotFoundError: the file does not exist.
        """
        try:
            found = json.loads(files.read_text(Path(file), MAX_BYTES))
            checks.one_of("kind", found.pop("kind"), ("estimate",))
            checks.one_of("version", found.pop("version"), (VERSION,))
            return cls(**_checked(found))
        except FileNotFoundError:
            raise
        except files.DAMAGE as error:
            raise ValueError(
                f"{file} must be an estimate: {files.describe_damage(error)}"
            ) from None


def _with(instance: Any, name: str, value: Any) -> Any:
    return replace(instance, **{name: value})


def _or_none(end: float) -> float | None:
    return end if math.isfinite(end) else None


def _checked(found: dict[str, Any]) -> dict[str, Any]:
    """Return an estimate's fields from a file's."""
    names = [each.name for each in fields(Estimate)]
    if sorted(found) != sorted(names):
        raise ValueError(f"fields must be {', '.join(names)}, got {', '.join(found)}")
    values = {str(name): checks.number(name, value) for name, value in found["values"].items()}
    ends = {
        name: (
            -math.inf if low is None else checks.number(name, low),
            math.inf if high is None else checks.number(name, high),
        )
        for name, (low, high) in found["intervals"].items()
    }
    if sorted(ends) != sorted(values):
        raise ValueError(f"intervals must be of {', '.join(values)}, got {', '.join(ends)}")
    correlated = tuple(map(str, found["correlated"]))
    size = (len(correlated), len(correlated))
    matrix = checks.array("correlations", found["correlations"], size)
    position, angle = checks.array("noise", found["noise"], (2,)).tolist()
    return {
        "values": values,
        "intervals": ends,
        "correlations": tuple(map(tuple, matrix.tolist())),
        "correlated": correlated,
        "inseparable": tuple(tuple(map(str, group)) for group in found["inseparable"]),
        "unknown": tuple(map(str, found["unknown"])),
        "misfit": checks.number("misfit", found["misfit"]),
        "is_explained": checks.one_of("is_explained", found["is_explained"], (True, False)),
        "misfits": tuple(checks.array("misfits", found["misfits"], (None,)).tolist()),
        "frames": checks.integer("frames", found["frames"], least=0),
        "noise": (position, angle),
        "delay": checks.number("delay", found["delay"]),
        "unused": {
            str(name): checks.integer(name, count, least=0)
            for name, count in found["unused"].items()
        },
    }
