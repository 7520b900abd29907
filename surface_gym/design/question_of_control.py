"""The question what axes that follow the parcel gain: its sentence, table and picture."""

import math
from dataclasses import dataclass

from matplotlib.figure import Figure

from surface_gym.design import telling
from surface_gym.design.case import Case
from surface_gym.design.control import ControlGain, Gain, control_gain
from surface_gym.design.pictures import BLUE, ORANGE
from surface_gym.design.questions import Answer, Question
from surface_gym.design.sending import Advance
from surface_gym.design.tables import Table


@dataclass(frozen=True)
class AskControl(Question):
    """What do axes gain that follow the parcel? Needs the package `agents`."""

    def answer(self, advance: Advance) -> Answer:
        case = self.case()
        if self.rows is not None:
            raise ValueError(f"rows must be those under the parcel for control, got {self.rows!r}")
        if self.cluster is not None:
            raise ValueError(
                f"cluster must not be given for control, which tries one controller after the "
                f"other, got {self.cluster!r}"
            )
        found = control_gain(case, self.columns, advance)
        return Answer(
            "control",
            control_told(case, found),
            (control_table(found),),
            lambda: draw_control(case, found),
        )


def control_told(case: Case, found: ControlGain) -> str:
    """The answer in words: the best of either kind."""
    once = [gain for gain in found.gains if gain.arranged_once]
    ruled = [gain for gain in found.gains if not gain.arranged_once]
    told = (
        f"On {found.columns} columns of {found.rows} rows, a "
        f"{telling.base_told(case.parcel.base)} at {case.speed:g} m/s, {found.asked}: "
        f"{_best_told(ruled)} by axes that follow it, {_best_told(once)} by axes arranged once"
    )
    if found.left_out:
        told += f". Left out, trained for the environment's own zone alone: {_listed(found)}"
    return told


def _best_told(gains: list[Gain]) -> str:
    success = max(gain.success for gain in gains)
    slowest = min((g.least_speed for g in gains if not math.isnan(g.least_speed)), default=math.nan)
    since = "at no speed" if math.isnan(slowest) else f"from {slowest:.2f} m/s on"
    return f"{success:.0%} of the draws and {since}"


def _listed(found: ControlGain) -> str:
    return ", ".join(found.left_out)


def control_table(found: ControlGain) -> Table:
    """A row a controller."""
    header = ("controller", "axes", "draws", "success in them", "from speed [m/s]", "median error")
    rows = tuple(
        (
            gain.controller,
            "arranged once" if gain.arranged_once else "follow",
            gain.draws,
            gain.success,
            gain.least_speed,
            gain.error,
        )
        for gain in found.gains
    )
    return Table("control", f"{found.asked[0].upper()}{found.asked[1:]}", header, rows)


def draw_control(case: Case, found: ControlGain) -> Figure:
    """Least entry speed and success in the draws, a bar a controller."""
    under = f"{telling.base_told(case.parcel.base)}; {found.columns} columns of {found.rows} rows"
    figure = Figure(figsize=(9.0, 3.2 + 0.22 * len(found.gains)), layout="constrained")
    figure.suptitle(f"What do axes gain that follow the parcel?\n{under}", fontsize="medium")
    left, right = figure.subplots(1, 2, sharey=True)
    gains = found.gains[::-1]
    names = [gain.controller for gain in gains]
    colours = [ORANGE if gain.arranged_once else BLUE for gain in gains]
    left.barh(names, [gain.success for gain in gains], color=colours)
    left.set(xlim=(0.0, 1.0), xlabel=f"success at {case.speed:g} m/s, by draws")
    left.xaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    right.barh(names, [gain.least_speed for gain in gains], color=colours)
    right.set(xlim=(0.0, case.speed), xlabel="least entry speed [m/s], nothing unknown")
    for k, gain in enumerate(gains):
        if math.isnan(gain.least_speed):
            right.text(0.02 * case.speed, k, "at no speed", va="center")
    for panel in (left, right):
        panel.grid(axis="x", alpha=0.3)
        panel.set_axisbelow(True)
    handles = [left.barh([0], [0.0], color=colour) for colour in (ORANGE, BLUE)]
    figure.legend(
        handles, ["arranged once", "follow the parcel"], loc="outside lower center", ncols=2
    )
    return figure
