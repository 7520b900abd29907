"""Loads that a parcel puts on modules, compared with a limit, and wear of actuators.
Draws are random choices of quantities that are unknown in a design, e.g. friction and load.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from surface_gym import checks, parallel
from surface_gym.design import case as cases, runs
from surface_gym.design.case import NOMINAL, SURE, WORST, Case
from surface_gym.design.limits import Arrangement, arrange
from surface_gym.physics.types import Array

LIMIT = 20.0  # [kg] load that a module of the study bears (Section 2)


@dataclass(frozen=True, eq=False)
class ModuleLoads(cases.Answer):
    """The largest load of a rotor under a passing parcel, for each draw of unknown quantities.

    Draws form groups. The draws of a group vary only the group's quantities, e.g. friction.
    """

    arrangement: Arrangement
    limit: float  # [kg] load that a module bears
    loads: dict[str, Array]  # (draws,) [kg] by group; `NOMINAL` has one draw

    name = "load"

    def load(self, group: str = NOMINAL) -> float:
        """Return the 95th percentile [kg] of the loads in the draws of `group`."""
        loads = np.sort(self.loads[group])
        return float(loads[math.ceil((1.0 - WORST) * len(loads) - 1e-9) - 1])

    def heaviest(self, group: str = NOMINAL) -> float:
        """Return the parcel's mass [kg] at which the result of `load` equals the limit."""
        return self.limit * self.arrangement.case.parcel.mass / self.load(group)

    @property
    def overloaded(self) -> bool:
        """Whether the load exceeds the limit in more than 5 % of the draws of any group."""
        return any(self.load(group) > self.limit for group in self.loads)

    @property
    def sentence(self) -> str:
        arrangement, case = self.arrangement, self.arrangement.case
        *_, worst = self.loads
        text = (
            f"On {arrangement.description} ({arrangement.chosen}), a {case.parcel_text} of "
            f"{case.parcel.mass:g} kg that comes {case.entry_text} loads a module with up to "
            f"{self.load():.3g} kg"
        )
        bears = f"{self.heaviest():.3g} kg"
        if worst != NOMINAL:
            text += f"; {self.load(worst):.3g} kg for {SURE} of the draws"
            bears += f"; {self.heaviest(worst):.3g} kg for {SURE} of the draws"
        found = "OVERLOADED: a" if self.overloaded else "A"
        return f"{text}. {found} module bears {self.limit:g} kg, so the parcel may weigh {bears}"

    def tables(self) -> tuple[cases.ReportTable, ...]:
        return (
            cases.ReportTable(
                "load",
                f"Largest load of a module, which bears {self.limit:g} kg",
                ("unknown", "load [kg]", "heaviest parcel [kg]", "draws within the limit"),
                tuple(
                    (
                        cases.group_label(group), self.load(group), self.heaviest(group),
                        float(np.mean(each <= self.limit)),
                    )
                    for group, each in self.loads.items()
                ),
            ),
        )  # fmt: skip

    def draw(self) -> "cases.Figure":
        """Draw the limit, and the distribution of largest loads for each group of unknowns."""
        case = self.arrangement.case
        figure, axes = cases.new_panel(
            "What must a module bear?", f"{case.parcel_text}; {self.arrangement.description}"
        )
        for group, loads in self.loads.items():
            colour, style = cases.LINES[group]
            axes.ecdf(loads, color=colour, linestyle=style, label=cases.group_label(group))
        axes.axvline(self.limit, color=cases.ORANGE, linewidth=0.8, label="limit")
        axes.set(xlabel="largest load of a module [kg]", ylabel="share of the draws")
        axes.legend(**cases.legend_of_drawn(axes))
        return figure


def module_loads(
    case: Case, columns: int | None = None, rows: int | None = None, limit: float = LIMIT,
    workers: parallel.Workers = 1, on_progress: runs.OnProgress = lambda *_: None,
) -> ModuleLoads:  # fmt: skip
    """Find the largest load that a parcel puts on a module, at the case's speed and tilt.

    A load [kg] is a normal force of Eq. (1), divided by g. All steps of a run count. `limit` [kg]
    is the load that a module can bear. For `columns`, `rows` and `workers` see `arrange`.
    """
    checks.positive("limit", limit, *checks.MASS)
    arrangement = arrange(case, columns, rows, workers)
    groups = {
        name: case.draw(arrangement.line, each) for name, each in case.unknown.by_group().items()
    }
    passed = arrangement.columns if case.purpose.leaves_zone else -1
    progress = runs.split_progress(on_progress, [len(drawn) for drawn in groups.values()])
    axes, loads = arrangement.layout.axis[np.newaxis], {}
    for (group, drawn), part in zip(groups.items(), progress, strict=True):
        asked = drawn.runs(case.speed, case.tilt, passed)
        loads[group] = case.run(arrangement.line, axes, asked, drawn, workers, part).load
    return ModuleLoads(arrangement, limit, loads)


def wear_tables(
    energy: float, life: float, lines: Sequence[tuple[tuple[str, ...], float, Any]]
) -> tuple[cases.ReportTable, ...]:
    """Return a table of the actuators' energy and life. The table has a row per item of `lines`.

    Args:
        energy: [J] energy of one turn of an actuator, or 0 if the energy is unknown.
        life: number of turns until an actuator fails, or infinite if the number is unknown. If
            energy and life are unknown, there is no table.
        lines: a tuple for each row. The tuple holds the row's first two cells, the average
            actuator's number of turns per parcel, and an object. The object has the attributes
            `turns_per_hour` (of the average actuator) and `rate` [parcels/h].
    """
    if not energy and life == math.inf:
        return ()
    rows = []
    for names, turns, run in lines:
        hours = life / run.turns_per_hour if run.turns_per_hour else math.inf
        rows.append((*names, turns, energy * turns, hours, hours * run.rate))
    return (
        cases.ReportTable(
            "flow-wear",
            f"Actuators of {energy:g} J and a life of {life:g} turns: the mean actuator",
            ("hardware", "angles", "turns/parcel", "J/parcel", "life [h]", "life [parcels]"),
            tuple(rows),
        ),
    )
