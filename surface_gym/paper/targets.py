"""The numbers that the paper prints, from `data/targets.json`, and ours compared with them."""

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

SIZES = ("S", "B")
_KEYS = {"S": "s_box", "B": "b_box"}


class SlowingLayout(NamedTuple):
    """An entry of Table 4."""

    columns: int  # of the slowing area
    angle: int  # [deg] 0, or 45 for +-45 in alternate rows

    def __str__(self) -> str:
        return f"{self.columns} at {'±' if self.angle else ''}{self.angle}°"


@dataclass(frozen=True)
class SortingRun:
    """A row of Table 2."""

    speed: float  # [m/s] at the start
    tilt: float  # [deg]
    time: float  # [s] simulated
    x: float  # [m] displacement from the start
    y: float  # [m]
    theta: float  # [deg]
    figure: str  # in which the paper draws it

    @property
    def side(self) -> int:
        """-1 for axes at +45 deg, which sort to y < 0; +1 for axes at -45 deg."""
        return 1 if self.y > 0.0 else -1


@dataclass(frozen=True)
class Passing:
    """State of the parcel at 10 deg when it is as far aside as that at 5 deg, Section 5.1."""

    tilt: float  # [deg]
    y: float  # [m] displacement at which the state is taken
    x: float  # [m] displacement
    theta: float  # [deg]
    time: float  # [s]


@dataclass(frozen=True)
class Targets:
    """The paper's tables. Mappings go from a box's size, "S" or "B", to a value per speed."""

    source: str
    sorting_runs: tuple[SortingRun, ...]  # Table 2
    passing: Passing
    sorting_speeds: tuple[float, ...]  # [m/s] of Table 3
    sorting_columns: dict[str, tuple[int | None, ...]]  # Table 3; None: the box is not sorted
    slowest_sorted: dict[str, float]  # [m/s] below it, the box is not sorted
    slowing_speeds: tuple[float, ...]  # [m/s] of Table 4
    slowing_layouts: dict[str, tuple[SlowingLayout, ...]]  # Table 4
    ratio_speed: float  # [m/s] of the slowing ratios in Section 5.2
    ratio_columns: int
    slowing_ratios: dict[str, dict[int, float]]  # by size, then axis angle [deg]
    medium_rates: tuple[float, float]  # [pcs/h] of torsional discs, Figure 8


@cache
def load_data() -> dict[str, Any]:
    """Read the file of the paper's numbers; those of Section 6 are under "validation"."""
    text = resources.files("surface_gym.paper").joinpath("data/targets.json").read_text("utf-8")
    data: dict[str, Any] = json.loads(text)
    return data


@cache
def load_targets() -> Targets:
    """Read the paper's tables of Section 5."""
    data = load_data()
    table3, table4, ratio = data["table3"], data["table4"], data["slowing_ratio"]
    passing = data["table2"]["passing"]
    low, high = data["sorting_rate"]["paper_band_pcs_per_h"]
    return Targets(
        source=data["source"],
        sorting_runs=tuple(SortingRun(*row) for row in data["table2"]["rows"]),
        passing=Passing(*(passing[key] for key in ("gamma", "dy", "dx", "theta", "time"))),
        sorting_speeds=tuple(table3["v0"]),
        sorting_columns={size: tuple(table3[_KEYS[size]]) for size in SIZES},
        slowest_sorted={size: table3["fails_below"][_KEYS[size]] for size in SIZES},
        slowing_speeds=tuple(table4["v0"]),
        slowing_layouts={
            size: tuple(SlowingLayout(*entry) for entry in table4[_KEYS[size]]) for size in SIZES
        },
        ratio_speed=ratio["v0"],
        ratio_columns=ratio["columns"],
        slowing_ratios={
            size: {int(angle): value for angle, value in ratio[_KEYS[size]].items()}
            for size in SIZES
        },
        medium_rates=(low, high),
    )


Value = int | float | SlowingLayout | None


@dataclass(frozen=True)
class Found:
    """A value of ours, and the share of its run that Eq. (1) cannot balance."""

    value: Value
    tipping: float | None  # [-] of the steps up to the value; None: there was no step


@dataclass(frozen=True)
class Cell:
    """One value of the paper beside ours, all in the unit that its column names.

    Numbers agree if, rounded as the paper prints them, they differ by the tolerance at most;
    other values agree if they are equal.
    """

    row: str
    column: str
    size: str  # of the box, "S" or "B"
    paper: Value
    ours: tuple[Found, ...]  # one per integration, in the order of `INTEGRATIONS`
    decimals: int = 0  # that the paper prints
    tolerance: float = 0.0

    def agrees(self, integration: int) -> bool:
        """Compare our value by the integration of that index with the paper's."""
        ours = self.ours[integration].value
        if isinstance(ours, (int, float)) and isinstance(self.paper, (int, float)):
            difference = round(ours, self.decimals) - self.paper
            return abs(round(difference, self.decimals)) <= self.tolerance
        return ours == self.paper


@dataclass(frozen=True)
class Table:
    """A table of the paper, or a sentence of it that states numbers."""

    key: str  # its name in the JSON report
    title: str
    rule: str  # what is counted, and when a cell agrees
    cells: tuple[Cell, ...]

    def agreeing(self, integration: int) -> int:
        """Count the cells that agree by the integration of that index."""
        return sum(cell.agrees(integration) for cell in self.cells)

    def tipping(self, integration: int) -> dict[str, tuple[float, float]]:
        """Range of the shares of a run's steps that would tip the box, by the box's size."""
        shares: dict[str, list[float]] = {}
        for cell in self.cells:
            share = cell.ours[integration].tipping
            if share is not None:
                shares.setdefault(cell.size, []).append(share)
        return {size: (min(found), max(found)) for size, found in shares.items()}
