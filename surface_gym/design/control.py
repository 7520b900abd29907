"""The gain of axes that follow the parcel over fixed layouts, on the same surface.

Rules and agents come with the `agents` package, which is imported only here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any

import numpy as np

from surface_gym import checks, lines
from surface_gym.design import report, runs
from surface_gym.design.case import Case, EnvGoal
from surface_gym.design.columns import least_columns
from surface_gym.physics.types import Array
from surface_gym.randomisation import Randomisation

SPEED_STEP = 0.02  # [m/s] between the entry speeds that are tried
# Controllers that search a layout for each start take up to a second for it: they get fewer.
FEW_DRAWS = 20
WIDE_STEP = 0.1  # [m/s]
SLOWEST = 0.1  # [m/s]
FIXED = "fixed"  # part of the names of controllers that never turn an axis under the parcel


@dataclass(frozen=True)
class Gain:
    """Results of one controller on the surface."""

    controller: str
    arranged_once: bool  # whether axes keep still while the parcel is on them
    draws: int  # that were tried
    success: float  # [-] share of the draws that succeed at the case's speed
    least_speed: float  # [m/s] from which on it succeeds up to the case's speed, nothing unknown
    error: float  # median of the task's metric in those draws, in SI units; nan: it has none


@dataclass(frozen=True)
class ControlGain(report.Answer):
    """Results of fixed layouts beside those of controllers that turn axes under the parcel."""

    case: Case
    task: str  # of the environment
    asked: str  # description of success in it
    columns: int  # of the zone
    rows: int  # of rotors
    gains: tuple[Gain, ...]
    left_out: tuple[str, ...]  # agents trained for zones of another size alone

    name = "control"

    @property
    def sentence(self) -> str:
        ruled, once = (
            _describe_best([gain for gain in self.gains if gain.arranged_once == fixed])
            for fixed in (False, True)
        )
        text = (
            f"On {self.columns} columns of {self.rows} rows, a {self.case.parcel_text} at "
            f"{self.case.speed:g} m/s, {self.asked}: {ruled} by axes that follow it, {once} by "
            "axes arranged once"
        )
        if self.left_out:
            agents = ", ".join(self.left_out)
            text += f". Left out, trained for the environment's own zone alone: {agents}"
        return text

    def tables(self) -> tuple[report.Table, ...]:
        rows = tuple(
            (
                gain.controller,
                "arranged once" if gain.arranged_once else "follow",
                gain.draws,
                gain.success,
                gain.least_speed,
                gain.error,
            )
            for gain in self.gains
        )
        title = f"{self.asked[0].upper()}{self.asked[1:]}"
        header = (
            "controller", "axes", "draws", "success in them", "from speed [m/s]", "median error",
        )  # fmt: skip
        return (report.Table("control", title, header, rows),)

    def draw(self) -> "report.Figure":
        """Draw success in the draws and the least entry speed, a bar for each controller."""
        speed, gains = self.case.speed, self.gains[::-1]
        subtitle = f"{self.case.parcel_text}; {self.columns} columns of {self.rows} rows"
        title = f"What do axes gain that follow the parcel?\n{subtitle}"
        figure = report.new_figure(9.0, 3.2 + 0.22 * len(gains), title, "medium")
        left, right = figure.subplots(1, 2, sharey=True)
        names = [gain.controller for gain in gains]
        colours = [report.ORANGE if gain.arranged_once else report.BLUE for gain in gains]
        left.barh(names, [gain.success for gain in gains], color=colours)
        left.set(xlim=(0.0, 1.0), xlabel=f"success at {speed:g} m/s, by draws")
        left.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
        right.barh(names, [gain.least_speed for gain in gains], color=colours)
        right.set(xlim=(0.0, speed), xlabel="least entry speed [m/s], nothing unknown")
        for k, gain in enumerate(gains):
            if math.isnan(gain.least_speed):
                right.text(0.02 * speed, k, "at no speed", va="center")
        for panel in (left, right):
            panel.grid(axis="x", alpha=0.3)
            panel.set_axisbelow(True)
        handles = [left.barh([0], [0.0], color=colour) for colour in (report.ORANGE, report.BLUE)]
        labels = ["arranged once", "follow the parcel"]
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
        return figure


def _describe_best(gains: Sequence[Gain]) -> str:
    success = max(gain.success for gain in gains)
    slowest = min((g.least_speed for g in gains if not math.isnan(g.least_speed)), default=math.nan)
    since = "at no speed" if math.isnan(slowest) else f"from {slowest:.2f} m/s on"
    return f"{success:.0%} of the draws and {since}"


def control_gain(
    case: Case, columns: int | None = None, on_progress: runs.OnProgress = lambda *_: None
) -> ControlGain:
    """Try the fixed layouts, the rules and the shipped agents on the surface of a case.

    Success is the environment's: Slow within 0.01 of the ratio, Stop within 5 mm of the place, Turn
    within 2 deg of the angle.
    """
    try:
        methods = import_module("surface_gym.agents.evaluation.methods")
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
    goal = case.purpose.env_goal(line)
    able: list[Any] = []
    left_out: list[Any] = []
    for method in (*methods.rules(goal.task), *methods.shipped(goal.task)):
        config = _make_config(method, case, line, goal, Randomisation())
        (able if _fits(method, config) else left_out).append(method)
    gains = []
    for done, method in enumerate(able):
        on_progress(done, len(able))
        gains.append(_try(method, case, line, goal))
    return ControlGain(
        case=case, task=goal.task, asked=goal.description, columns=columns, rows=line.rows,
        gains=tuple(gains), left_out=tuple(method.name for method in left_out),
    )  # fmt: skip


def _fits(method: Any, config: Any) -> bool:
    """Return whether a controller's actions are those of a zone of this size."""
    from surface_gym import SmartSurfaceVectorEnv

    env = SmartSurfaceVectorEnv(num_envs=1, **config.arguments())
    seen, _ = env.reset(seed=0)
    action, _ = method.make(config, 0).predict(seen)
    env.close()
    return bool(np.shape(action)[1:] == config.action_space().shape)


def _try(method: Any, case: Case, line: runs.DesignLine, goal: EnvGoal) -> Gain:
    run_episodes = import_module("surface_gym.agents.rollout").run_episodes

    def run(speeds: Array, randomisation: Randomisation) -> Any:
        config = _make_config(method, case, line, goal, randomisation)
        starts = [{"speed": float(speed), goal.option: goal.value} for speed in speeds]
        return run_episodes(method.make(config, 0), config, starts, case.seed)

    searches = method.starts is not None
    draws = min(case.draws, FEW_DRAWS) if searches else case.draws
    rng = np.random.default_rng(case.seed)
    speeds = case.speed + case.unknown.speed * rng.standard_normal(draws)
    # The unknown quantities but for the speed, which environments do not draw.
    names = (each.name for each in fields(Randomisation))
    randomisation = Randomisation(**{name: getattr(case.unknown, name) for name in names})
    drawn = run(np.clip(speeds, SLOWEST, 5.0), randomisation)
    slower = np.arange(case.speed, SLOWEST, -WIDE_STEP if searches else -SPEED_STEP).round(9)
    fails = np.nonzero(~run(slower, Randomisation()).success)[0]
    reached = len(slower) if len(fails) == 0 else int(fails[0])
    errors = [np.abs(values) for values in drawn.metrics.values()]
    return Gain(
        controller=method.name,
        arranged_once=FIXED in method.name,
        draws=draws,
        success=float(drawn.success.mean()),
        least_speed=float(slower[reached - 1]) if reached else math.nan,
        error=float(np.median(errors[0])) if errors else math.nan,
    )


def _make_config(
    method: Any, case: Case, line: runs.DesignLine, goal: EnvGoal, randomisation: Randomisation
) -> Any:
    """Make the configuration of an environment on the line."""
    from surface_gym.config import EnvConfig
    from surface_gym.tasks import TASKS

    base_line = lines.Line(
        rows=line.shape[0], columns=line.shape[1], zone_rows=line.rows, zone_columns=line.columns,
        line_y=line.line_y, pitch=line.pitch, origin=(0.5 * line.pitch_x, 0.5 * line.pitch_y),
        mu_max=line.mu_max, mu_min=line.mu_min, mu_support=line.mu_support,
    )  # fmt: skip
    return EnvConfig(
        task=TASKS[goal.task](parcels=(case.parcel,)), actions=method.actions,
        control_period=method.control_period, orientations=method.orientations,
        observe=method.observe, randomisation=randomisation, line=base_line,
    )  # fmt: skip
