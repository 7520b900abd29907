"""The paper's numbers, read from `data/targets.json`."""

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources

from surface_gym.paper.comparison import SlowingLayout

SIZES = ("S", "B")
_KEYS = {"S": "s_box", "B": "b_box"}


@dataclass(frozen=True)
class SortingRun:
    """A row of Table 2."""

    speed: float  # [m/s] at the start
    tilt: float  # [deg]
    time: float  # [s] simulated
    x: float  # [m] displacement from the start
    y: float  # [m]
    theta: float  # [deg]
    figure: str  # where the paper draws it

    @property
    def side(self) -> int:
        """-1 where the axes stand at +45 deg, which sorts to y < 0; +1 at -45 deg."""
        return 1 if self.y > 0.0 else -1


@dataclass(frozen=True)
class Passing:
    """Section 5.1: where and when the parcel on the tilted surface passes a lateral distance."""

    tilt: float  # [deg]
    y: float  # [m] displacement at which it is looked at
    x: float  # [m] displacement
    theta: float  # [deg]
    time: float  # [s]


@dataclass(frozen=True)
class Targets:
    """The paper's tables. Mappings go from a box's size, "S" or "B", to a value a speed."""

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
def load_targets() -> Targets:
    """The paper's tables as the package carries them."""
    text = resources.files("surface_gym.paper").joinpath("data/targets.json").read_text("utf-8")
    data = json.loads(text)
    table3, table4, ratio = data["table3"], data["table4"], data["slowing_ratio"]
    passing = data["table2"]["passing"]
    low, high = data["sorting_rate"]["paper_band_pcs_per_h"]
    return Targets(
        source=data["source"],
        sorting_runs=tuple(SortingRun(*row) for row in data["table2"]["rows"]),
        passing=Passing(
            passing["gamma"], passing["dy"], passing["dx"], passing["theta"], passing["time"]
        ),
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
