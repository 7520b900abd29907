"""Estimates that `identify` makes of a surface: their values, their files and a page of HTML."""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from html import escape
from pathlib import Path
from typing import Any

from surface_gym import checks, files
from surface_gym.config import EnvConfig, Preset
from surface_gym.lines import BaseLine
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import AdaptiveCamera, Camera

VERSION = 1  # of the file's format
MAX_BYTES = 2**20  # of an estimate's file
FRICTIONS = ("mu_max", "mu_min", "mu_support")
MOST_SPREAD = 0.5  # [-] of friction in a preset
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 60rem; padding: 0 1rem;
  color-scheme: light dark; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { padding: .25rem .75rem; text-align: right; border-bottom: 1px solid #8884; }
th:first-child, td:first-child, .text { text-align: left; }
svg { display: block; max-width: 100%; }
.warning { border-left: 4px solid #d97706; padding-left: 1rem; }
"""
BAR = 6.0  # [px] width of a run's bar
HIGH = 120.0  # [px] height of the figure
MOST = 4.0  # [-] misfit at its top


@dataclass(frozen=True)
class Parameter:
    """A parameter of the surface or the load that can be estimated from logs."""

    unit: str
    meaning: str
    low: float  # smallest value that is searched
    high: float  # largest
    apart: float  # difference of the two predictions of a derivative, halved
    step: float  # by which a first guess may be off


PARAMETERS = {
    "mu_max": Parameter("-", "friction along an axis", 0.02, 2.0, 4e-3, 0.1),
    "mu_min": Parameter("-", "friction across it", 0.0, 0.3, 1e-3, 5e-3),
    "mu_support": Parameter("-", "friction of a support", 0.0, 0.3, 1e-3, 5e-3),
    "tilt": Parameter("rad", "tilt, downhill towards +x", -0.5, 0.5, 1e-3, 0.02),
    "quarter_turn": Parameter("s", "time in which an axis turns by 90 deg", 1e-3, 1.0, 1e-3, 0.03),
    "dead_time": Parameter(
        "s", "time from a command to the start of the turn", 0.0, 0.5, 1e-3, 0.02
    ),
    "latency": Parameter(
        "s", "time from a picture's exposure to its stated time", -0.1, 0.5, 1e-3, 0.02
    ),
    "com_x": Parameter("m", "load ahead of the base's middle", -0.2, 0.2, 1e-3, 0.01),
    "com_y": Parameter("m", "load to the left of it", -0.2, 0.2, 1e-3, 0.01),
}


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters of a surface, with 95 % intervals and the quality of the fit."""

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
        """Return whether the logs determine the parameter `name`."""
        return name in self.intervals and math.isfinite(self.intervals[name][0])

    @property
    def late(self) -> float:
        """Time [s] from a picture's exposure to its message."""
        stale = self.values["latency"] if self.is_determined("latency") else 0.0
        return max(0.0, self.delay + stale)

    def line(self, line: BaseLine) -> BaseLine:
        """Copy an environment's line, and set the copy's friction to the identified values."""
        found: Any = {name: self.values[name] for name in filter(self.is_determined, FRICTIONS)}
        return replace(line, **found)

    def preset(self, name: str = "identified") -> Preset:
        """Return a preset that sets noise, delay, axis speed and spread of friction.

        The preset does not set mean friction and tilt. For mean friction, use the method `line`.
        Set the tilt in the task.
        """
        speed = math.inf
        if self.is_determined("quarter_turn"):
            speed = 0.5 * math.pi / max(self.values["quarter_turn"], 1e-3)
        return Preset(
            name,
            name,
            f"The machine of {len(self.misfits)} logged runs.",
            sensors=AdaptiveCamera(
                latency=self.late, position_noise=self.noise[0], angle_noise=self.noise[1]
            ),
            actuators=Actuators(axis_speed=speed),
            randomisation=Randomisation(
                friction=self._spread("mu_max"),
                rolling=max(self._spread("mu_min"), self._spread("mu_support")),
            ),
        )

    def adapt(self, config: EnvConfig) -> EnvConfig:
        """Return an environment's configuration, changed to the identified surface.

        Friction is from the method `line`. The spread of friction, the axis speed, and a camera's
        noise and latency are from the method `preset`. Undetermined values and the tilt do not
        change. If a tilt was identified, set this tilt in the task.
        """
        found, sensors = self.preset(), config.sensors
        if isinstance(sensors, Camera):
            position, angle = self.noise
            sensors = replace(sensors, position_noise=position, angle_noise=angle)
            if self.is_determined("latency"):
                sensors = replace(sensors, latency=self.late)
        actuators, spread = config.actuators, config.randomisation
        if self.is_determined("quarter_turn"):
            actuators = replace(actuators, axis_speed=found.actuators.axis_speed)
        if self.is_determined("mu_max"):
            spread = replace(spread, friction=found.randomisation.friction)
        if self.is_determined("mu_min") or self.is_determined("mu_support"):
            spread = replace(spread, rolling=found.randomisation.rolling)
        return config.replace(
            line=self.line(config.chosen_line),
            sensors=sensors,
            actuators=actuators,
            randomisation=spread,
        )

    def _spread(self, name: str) -> float:
        """Return the interval's half width / value, or 0 if the parameter is not determined."""
        if not self.is_determined(name):
            return 0.0
        low, high = self.intervals[name]
        value = self.values[name]
        return min(MOST_SPREAD, 0.5 * (high - low) / value) if value > 0.0 else MOST_SPREAD

    def warnings(self) -> Iterator[str]:
        """Yield sentences about a bad fit, parameters that are not determined, and unused runs."""
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
        """Write the estimate as JSON. Infinite ends of intervals are written as null."""
        content = {"kind": "estimate", "version": VERSION, **asdict(self)}
        ends = {
            name: [end if math.isfinite(end) else None for end in pair]
            for name, pair in self.intervals.items()
        }
        with files.replacing(Path(file)) as part:
            part.write_text(json.dumps({**content, "intervals": ends}, indent=1, allow_nan=False))

    @classmethod
    def load(cls, file: str | Path) -> "Estimate":
        """Read an estimate from a file of `save`.

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


def _checked(found: dict[str, Any]) -> dict[str, Any]:
    """Check the content of a file, `found`, and return it as the fields of an `Estimate`."""
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


def write_report(found: Estimate, file: Path) -> None:
    """Write a page of HTML with an estimate's values, intervals, correlations and misfits."""
    warnings = "".join(f'<p class="warning">{escape(each)}</p>' for each in found.warnings())
    content = (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>Identified surface</title>"
        f"<style>{STYLE}</style><h1>Identified surface</h1>"
        f"<p>{len(found.misfits)} runs, {found.frames} pictures with a noise of "
        f"{1e3 * found.noise[0]:.2f} mm and {math.degrees(found.noise[1]):.2f} deg, which arrive "
        f"{1e3 * found.delay:.0f} ms late. Misfit {found.misfit:.2f}.</p>{warnings}"
        f"{_values(found)}<h2>Correlations of the errors</h2>{_correlations(found)}"
        f"<h2>Misfit of each run</h2>{_misfits(found)}"
        "<p>A misfit of 1 is as large as the pictures' noise explains. The line marks 1.</p></html>"
    )
    with files.replacing(file) as part:
        part.write_text(content, encoding="utf-8")


def describe_value(found: Estimate, name: str) -> tuple[str, str]:
    """Return two texts for the parameter `name`: the value with its unit, and the interval."""
    unit = PARAMETERS[name].unit
    value = f"{found.values[name]:.5g}" + ("" if unit == "-" else f" {unit}")
    if not found.is_determined(name):
        return "-", "not determined"
    low, high = found.intervals[name]
    return value, f"{low:.5g} to {high:.5g}"


def _values(found: Estimate) -> str:
    rows = ""
    for name in found.values:
        value, interval = describe_value(found, name)
        meaning = escape(PARAMETERS[name].meaning)
        rows += f"<tr><td>{name}<td class=text>{meaning}<td>{value}<td>{interval}"
    return f"<table><tr><th>parameter<th class=text>meaning<th>value<th>95 % interval{rows}</table>"


def _correlations(found: Estimate) -> str:
    head = "".join(f"<th>{name}" for name in found.correlated)
    rows = ""
    for name, row in zip(found.correlated, found.correlations, strict=True):
        cells = "".join(
            f'<td style="background: rgb(217 119 6 / {abs(each):.2f})">{each:.2f}' for each in row
        )
        rows += f"<tr><td>{name}{cells}"
    return f"<table><tr><th>{head}{rows}</table>"


def _misfits(found: Estimate) -> str:
    bars = ""
    for k, misfit in enumerate(found.misfits):
        height = HIGH * min(misfit, MOST) / MOST
        bars += (
            f'<rect x="{(BAR + 2.0) * k:g}" y="{HIGH - height:.1f}" width="{BAR:g}" '
            f'height="{height:.1f}" fill="#0d9488"><title>run {k + 1}: {misfit:.2f}</title></rect>'
        )
    width = (BAR + 2.0) * len(found.misfits)
    one = HIGH * (1.0 - 1.0 / MOST)
    return (
        f'<svg width="{width:g}" height="{HIGH:g}" role="img" aria-label="misfit of each run">'
        f'{bars}<line x1="0" x2="{width:g}" y1="{one:g}" y2="{one:g}" stroke="currentColor"/></svg>'
    )
