"""The questions of the command line, a class each, and what answers them."""

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from matplotlib.figure import Figure

from surface_gym import checks
from surface_gym.design import pictures, tables, telling
from surface_gym.design.best_layout import best_layout
from surface_gym.design.columns import Columns, columns_by_rows, least_columns
from surface_gym.design.limits import friction_range, least_speed, least_tilt
from surface_gym.design.options import CaseOptions, Given
from surface_gym.design.picture_of_layout import draw_layout
from surface_gym.design.picture_of_map import draw_map
from surface_gym.design.search import Effort
from surface_gym.design.sending import Advance
from surface_gym.design.sensitivity import sensitivity
from surface_gym.design.size_map import success_map
from surface_gym.design.tables_of_layout import layout_tables
from surface_gym.lines import ORIENTATIONS

SPEED_STEP = 0.1  # [m/s] of the picture of columns
ZONE = 16  # columns of a layout, where nothing else is said


@dataclass(frozen=True)
class Answer:
    """To a question: in a sentence, as tables and as a picture."""

    name: str  # of the picture's file, without the ending
    told: str
    tables: tuple[tables.Table, ...]
    draw: Callable[[], Figure]


@dataclass(frozen=True)
class Question(CaseOptions):
    """What can be asked of a case."""

    @property
    def checkpoint(self) -> Path | None:
        """File that keeps how far it is, to go on from; None: it is done in seconds."""
        return None

    @abstractmethod
    def answer(self, advance: Advance) -> Answer:
        """Work it out.

        Args:
            advance: called with how many runs are done and how many there are.

        Raises:
            ValueError: a flag that is not allowed.
        """


@dataclass(frozen=True)
class AskColumns(Question):
    """How many columns, and rows, does it take?"""

    def answer(self, advance: Advance) -> Answer:
        case = self.case()
        if self.columns is not None:
            raise ValueError("columns must not be given: they are what is asked for")
        every = (
            columns_by_rows(case, workers=self.crew)
            if self.rows is None
            else (least_columns(case, self.rows, workers=self.crew),)
        )
        top = max(3.0, 1.5 * case.speed)
        speeds = (SPEED_STEP * np.arange(1, round(top / SPEED_STEP) + 1)).round(9).tolist()
        found: list[tuple[float, Columns]] = []
        for done, speed in enumerate(speeds):
            advance(done, len(speeds))
            found.append((speed, least_columns(case.at(speed), self.rows, workers=self.crew)))
        own = every[-1]
        return Answer(
            "columns",
            telling.columns_told(case, own),
            tables.columns_tables(case.purpose, every, found),
            lambda: pictures.draw_columns(case, own.rows, found, own),
        )


@dataclass(frozen=True)
class AskSpeed(Question):
    """How slow may it come, and how fast?"""

    highest: Given = None
    """[m/s] entry speed to try; else 3, or half as much again as --speed."""

    def answer(self, advance: Advance) -> Answer:
        case = self.case()
        found = least_speed(case, self.columns, self.rows, self.highest, self.crew, advance)
        question = f"How slow may it come to {telling.purpose_met(case.purpose)}?"
        return Answer(
            "speed",
            telling.limits_told(found),
            tables.limits_tables("speed", found),
            lambda: pictures.draw_limits(question, found),
        )


@dataclass(frozen=True)
class AskTilt(Question):
    """How flat may the surface be, and how steep? With --speed 0, from rest."""

    highest_deg: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None
    """Tilt to try; else 15, or half as much again as --tilt-deg."""

    def answer(self, advance: Advance) -> Answer:
        case = self.case()
        highest = None if self.highest_deg is None else math.radians(self.highest_deg)
        found = least_tilt(case, self.columns, self.rows, highest, self.crew, advance)
        question = f"How flat may the surface be for it to {telling.purpose_met(case.purpose)}?"
        return Answer(
            "tilt",
            telling.limits_told(found),
            tables.limits_tables("tilt", found),
            lambda: pictures.draw_limits(question, found),
        )


@dataclass(frozen=True)
class AskFriction(Question):
    """How far may friction be off?"""

    def answer(self, advance: Advance) -> Answer:
        found = friction_range(self.case(), self.columns, self.rows, self.crew, advance)
        return Answer(
            "friction",
            telling.friction_told(found),
            tables.friction_tables(found),
            lambda: pictures.draw_friction(found),
        )


@dataclass(frozen=True)
class AskMap(Question):
    """Which entry speeds and sizes of the parcel does one surface serve?"""

    speeds: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="LOW HIGH")] = None
    """[m/s] least and most; else 0.1 and 3, or half as much again as --speed."""
    sizes: tuple[float, float] = (0.5, 1.5)
    """Least and most, over the parcel's own."""
    cells: int = 40
    """Speeds, and sizes."""
    resume: bool = False
    """Go on with a map that was stopped, from its map.npz in --out."""

    def answer(self, advance: Advance) -> Answer:
        case = self.case()
        checks.integer("cells", self.cells, least=1)
        ends = (0.1, max(3.0, 1.5 * case.speed)) if self.speeds is None else self.speeds
        if not self.resume:
            self.checkpoint.unlink(missing_ok=True)
        found = success_map(
            case,
            self.columns,
            np.linspace(*ends, self.cells).tolist(),
            np.linspace(*self.sizes, self.cells).tolist(),
            self.rows,
            self.crew,
            self.checkpoint,
            advance,
        )
        return Answer(
            "map",
            telling.map_told(found),
            tables.map_tables(found),
            lambda: draw_map(found),
        )

    @property
    def checkpoint(self) -> Path:
        """File of the sizes that are done."""
        return self.out / "map.npz"


@dataclass(frozen=True)
class AskSensitivity(Question):
    """What matters most of what is not known?"""

    def answer(self, advance: Advance) -> Answer:
        found = sensitivity(self.case(), self.columns, self.rows, self.crew, advance)
        return Answer(
            "sensitivity",
            telling.sensitivity_told(found),
            tables.sensitivity_tables(found),
            lambda: pictures.draw_sensitivity(found),
        )


@dataclass(frozen=True)
class AskLayout(Question):
    """Which fixed layout does best over a range of entry speeds?"""

    speeds: tuple[float, float] = (0.3, 2.7)
    """[m/s] least and most; --speed does not count."""
    speed_step: float = 0.02
    """[m/s] between them."""
    any_angle: bool = False
    """Search any axes, not 0, 45, -45 and 90 deg only."""
    members: int = Effort.members
    """Layouts in the search's population."""
    epochs: int = Effort.epochs
    """Of the search, of ten generations each."""
    resume: bool = False
    """Go on with a search that was stopped, from its layout.npz in --out."""

    def answer(self, advance: Advance) -> Answer:
        case = self.case()
        least, most = self.speeds
        step = checks.positive("speed_step", self.speed_step, 1e-4, 20.0)
        if not least <= most:
            raise ValueError(f"speeds must be the least and the most, got {self.speeds!r}")
        speeds = least + step * np.arange(math.floor((most - least) / step + 1e-6) + 1)
        if not self.resume:
            self.checkpoint.unlink(missing_ok=True)
        found = best_layout(
            case,
            speeds.round(9).tolist(),
            ZONE if self.columns is None else self.columns,
            self.rows,
            None if self.any_angle else ORIENTATIONS,
            Effort(members=self.members, epochs=self.epochs),
            self.crew,
            self.checkpoint,
            advance,
        )
        return Answer(
            "layout",
            telling.layout_told(found),
            layout_tables(found),
            lambda: draw_layout(found),
        )

    @property
    def checkpoint(self) -> Path:
        """File of how far the search is."""
        return self.out / "layout.npz"
