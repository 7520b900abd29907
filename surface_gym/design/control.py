"""What axes that follow the parcel gain over axes arranged once, on the same surface.

Rules and agents come with the `agents` package, which is asked for only here.
"""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.design.case import Case
from surface_gym.design.columns import least_columns
from surface_gym.design.line import DesignLine
from surface_gym.design.purposes import Purpose, Slow, Sort, Stop, Turn
from surface_gym.design.sending import Advance
from surface_gym.find_agents import import_agents
from surface_gym.lines import Line
from surface_gym.randomisation import Randomisation

SPEED_STEP = 0.02  # [m/s] between the entry speeds that are tried
# Who searches a layout for each start takes up to a second for it, and is tried on fewer.
FEW_DRAWS = 20
WIDE_STEP = 0.1  # [m/s]
SLOWEST = 0.1  # [m/s]
FIXED = "fixed"  # layouts whose names hold it are arranged once

Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Gain:
    """One controller on the surface."""

    controller: str
    arranged_once: bool  # its axes stay as they are while the parcel is on them
    draws: int  # that it is tried on
    success: float  # [-] share of the draws in which it succeeds at the case's speed
    least_speed: float  # [m/s] from which on it succeeds up to the case's speed, nothing unknown
    error: float  # median of the task's figure in those draws, in SI units; nan: it has none


@dataclass(frozen=True)
class ControlGain:
    """Fixed layouts beside controllers that turn axes under the parcel, every 40 ms."""

    task: str  # the environment's
    asked: str  # what counts as success there
    columns: int  # of the zone
    rows: int  # of rotors
    gains: tuple[Gain, ...]
    left_out: tuple[str, ...]  # agents that were trained for zones of another size alone


@dataclass(frozen=True)
class _Asked:
    """A purpose as an environment's task has it."""

    task: str
    option: str  # that says what is asked of a start
    value: float
    told: str


def control_gain(
    case: Case, columns: int | None = None, advance: Advance = lambda *_: None
) -> ControlGain:
    """Try the fixed layouts, the rules and the shipped agents on the surface of a case.

    Success is the environment's: Slow within 0.01 of the ratio, Stop within 5 mm of the place, Turn
    within 2 deg of the angle.

    Args:
        case: what it is for, level.
        columns: of the zone; None: what it takes by the study's kind of layout.
        advance: called with how many controllers were tried and how many there are.

    Raises:
        ValueError: a tilted case, columns that are not enough and were not given, or a parcel that
            the environment's line has no room for.
        ImportError: the package `agents` is not installed.
    """
    try:
        contenders = import_agents("evaluation.contenders")
    except ImportError as error:
        raise ImportError(
            f"controllers come with the package agents ({error}): pip install 'surface_gym[agents]'"
        ) from None
    if case.tilt or case.unknown.tilt:
        raise ValueError(f"tilt must be 0 for controllers on a line, got {case.tilt!r}")
    if columns is None:
        columns = least_columns(case).columns
        if columns is None:
            raise ValueError(
                f"columns must be given where no fixed layout does it: none does at {case.speed:g} "
                f"m/s, got {columns!r}"
            )
    line = case.line(checks.integer("columns", columns, least=1))
    asked = _asked(case.purpose, line)
    able: list[Any] = []
    left_out: list[Any] = []
    for contender in (*contenders.rules(asked.task), *contenders.shipped(asked.task)):
        settings = _settings(contender, case, line, asked, Randomisation())
        (able if _fits(contender, settings) else left_out).append(contender)
    gains = []
    for done, contender in enumerate(able):
        advance(done, len(able))
        gains.append(_try(contender, case, line, asked))
    return ControlGain(
        task=asked.task,
        asked=asked.told,
        columns=columns,
        rows=line.rows,
        gains=tuple(gains),
        left_out=tuple(contender.name for contender in left_out),
    )


def _fits(contender: Any, settings: Any) -> bool:
    """Whether a controller's actions are those of a zone of this size."""
    from surface_gym import SmartSurfaceVectorEnv

    arguments = import_agents("episodes").arguments(settings)
    env = SmartSurfaceVectorEnv(num_envs=1, **arguments)
    seen, _ = env.reset(seed=0)
    action, _ = contender.make(settings, 0).predict(seen)
    env.close()
    return bool(np.shape(action)[1:] == settings.action_space().shape)


def _asked(purpose: Purpose, line: DesignLine) -> _Asked:
    if isinstance(purpose, Slow):
        return _Asked("slow", "ratio", purpose.ratio, f"exit speed {purpose.ratio:g} of the entry "
                      "speed, within 0.01")  # fmt: skip
    if isinstance(purpose, Stop):
        first, last = line.zone_x
        place = 0.5 * (last - first) if purpose.place is None else purpose.place
        return _Asked("stop", "position", first + place, f"at rest {place:g} m past the zone's "
                      "start, within 5 mm")  # fmt: skip
    if isinstance(purpose, Turn):
        degrees = math.degrees(purpose.angle)
        return _Asked("orient", "angle", purpose.angle, f"turned by {degrees:g} deg on leaving the "
                      "zone, within 2 deg")  # fmt: skip
    assert isinstance(purpose, Sort)
    told = "off the line to y > 0" if purpose.side > 0 else "off the line to y < 0"
    return _Asked("sort", "side", purpose.side, told)


def _try(contender: Any, case: Case, line: DesignLine, asked: _Asked) -> Gain:
    run_episodes = import_agents("episodes").run_episodes

    def succeeds(speeds: Numbers, randomisation: Randomisation) -> Any:
        settings = _settings(contender, case, line, asked, randomisation)
        starts = [{"speed": float(speed), asked.option: asked.value} for speed in speeds]
        return run_episodes(contender.make(settings, 0), settings, starts, case.seed)

    searches = contender.starts is not None
    draws = min(case.draws, FEW_DRAWS) if searches else case.draws
    rng = np.random.default_rng(case.seed)
    speeds = case.speed + case.unknown.speed * rng.standard_normal(draws)
    drawn = succeeds(np.clip(speeds, SLOWEST, 5.0), _randomisation(case))
    slower = np.arange(case.speed, SLOWEST, -WIDE_STEP if searches else -SPEED_STEP).round(9)
    fails = np.nonzero(~succeeds(slower, Randomisation()).success)[0]
    reached = len(slower) if len(fails) == 0 else int(fails[0])
    figures = [np.abs(values) for values in drawn.figures.values()]
    return Gain(
        controller=contender.name,
        arranged_once=FIXED in contender.name,
        draws=draws,
        success=float(drawn.success.mean()),
        least_speed=float(slower[reached - 1]) if reached else math.nan,
        error=float(np.median(figures[0])) if figures else math.nan,
    )


def _settings(
    contender: Any, case: Case, line: DesignLine, asked: _Asked, randomisation: Randomisation
) -> Any:
    """Of an environment whose surface is the line."""
    from surface_gym.settings import Settings
    from surface_gym.tasks import TASKS

    plant = Line(
        rows=line.shape[0],
        columns=line.shape[1],
        zone_rows=line.rows,
        zone_columns=line.columns,
        line_y=line.line_y,
        pitch=line.pitch,
        origin=(0.5 * line.pitch_x, 0.5 * line.pitch_y),
        mu_max=line.mu_max,
        mu_min=line.mu_min,
        mu_support=line.mu_support,
    )
    return Settings(
        task=TASKS[asked.task](parcels=(case.parcel,)),
        actions=contender.actions,
        control_period=contender.control_period,
        orientations=contender.orientations,
        observe=contender.observe,
        randomisation=randomisation,
        plant=plant,
    )


def _randomisation(case: Case) -> Randomisation:
    """What is unknown, but for the speed, as environments have it."""
    return Randomisation(
        **{field.name: getattr(case.unknown, field.name) for field in fields(Randomisation)}
    )
