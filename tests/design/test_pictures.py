"""The pictures: drawn for whatever is found, light, and with their questions."""

from collections.abc import Callable
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from surface_gym import layouts
from surface_gym.design.best_layout import best_layout
from surface_gym.design.case import NOTHING, Case
from surface_gym.design.columns import columns_by_speed, least_columns
from surface_gym.design.limits import friction_range, least_speed
from surface_gym.design.picture_of_layout import draw_layout
from surface_gym.design.picture_of_map import draw_map
from surface_gym.design.pictures import (
    DPI,
    LINES,
    draw_columns,
    draw_friction,
    draw_limits,
    draw_sensitivity,
)
from surface_gym.design.purposes import Slow, Sort, Stop, Turn
from surface_gym.design.search import Effort
from surface_gym.design.sensitivity import sensitivity
from surface_gym.design.size_map import success_map

SPEEDS = [0.3, 1.0, 1.5]
BOX = layouts.box("S")
EFFORT = Effort(members=5, generations=1, epochs=0, rounds=0)

CASES = {
    "sort": (Case(BOX, Sort(), speed=1.2, draws=5), 5),
    "sort, nothing unknown": (Case(BOX, Sort(), speed=1.2, unknown=NOTHING), 5),
    "sort, never": (Case(BOX, Sort(), speed=0.2, draws=5), 2),
    "slow": (Case(layouts.box("B"), Slow(0.7), speed=2.5, draws=5), 4),
    "stop": (Case(BOX, Stop(0.3, 0.1), speed=1.5, draws=5), 5),
    "turn": (Case(BOX, Turn(), speed=1.5, draws=5), 6),
}


def of_columns(case: Case, _: int) -> Figure:
    found = list(zip(SPEEDS, columns_by_speed(case, SPEEDS), strict=True))
    return draw_columns(case, 2, found, least_columns(case))


PICTURES: dict[str, Callable[[Case, int], Figure]] = {
    "columns": of_columns,
    "limits": lambda case, columns: draw_limits("How slow?", least_speed(case, columns)),
    "friction": lambda case, columns: draw_friction(friction_range(case, columns)),
    "map": lambda case, columns: draw_map(success_map(case, columns, SPEEDS, [0.8, 1.0])),
    "sensitivity": lambda case, columns: draw_sensitivity(sensitivity(case, columns)),
    "layout": lambda case, columns: draw_layout(
        best_layout(case, SPEEDS, columns, effort=EFFORT)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("picture", PICTURES)
def test_a_picture_asks_its_question_and_names_its_axes(
    picture: str, name: str, tmp_path: Path
) -> None:
    figure = PICTURES[picture](*CASES[name])
    figure.savefig(tmp_path / "picture.png", dpi=DPI)
    assert (tmp_path / "picture.png").stat().st_size < 200_000
    assert "?" in figure.get_suptitle()
    labelled = [axes for axes in figure.axes if axes.get_xlabel()]
    assert labelled
    assert figure.axes[0].get_ylabel() or picture == "sensitivity"


def test_a_map_of_one_cell_has_no_contours(tmp_path: Path) -> None:
    case, columns = CASES["sort"]
    draw_map(success_map(case, columns, [1.0], [1.0])).savefig(tmp_path / "map.png")


def test_lines_differ_in_colour_and_in_style() -> None:
    assert len({colour for colour, _ in LINES.values()}) == len(LINES)
    alone = [style for group, (_, style) in LINES.items() if group not in ("nominal", "together")]
    assert len({str(style) for style in alone}) == len(alone)
