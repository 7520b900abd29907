"""A trajectory drawn: what is to be seen in the figure."""

import math
import sys
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.trajectory import Trajectory

matplotlib = pytest.importorskip("matplotlib")

BOX = sg.layouts.box("S")


@cache
def sort() -> Trajectory:
    return sg.simulate(sg.layouts.sorting(), BOX, sg.layouts.start("S"), (1.5, 0.0, 0.0))


def supports(rows: int, columns: int) -> sg.Surface:
    return sg.Surface(np.zeros((rows, columns)), np.zeros((rows, columns), dtype=bool))


def lines_of(panel: object) -> list[np.ndarray]:
    return [line.get_xydata() for line in panel.lines]


def test_the_way_and_the_velocities_are_the_trajectorys():
    run = sort()
    way, linear, turning = run.plot().axes
    assert any(np.array_equal(line, run.pose[:, :2]) for line in lines_of(way))
    for k, panel in ((0, linear), (1, linear), (2, turning)):
        expected = np.column_stack([run.time, run.velocity[:, k]])
        assert any(np.array_equal(line, expected) for line in lines_of(panel))


def test_the_first_and_last_outline_are_the_bases_and_the_darkest():
    run = sort()
    outlines = run.plot().axes[0].patches
    assert len(outlines) == 7
    np.testing.assert_allclose(
        outlines[0].get_xy()[:4], BOX.base.outline + run.pose[0, :2], atol=1e-12
    )
    turned = outlines[-1].get_xy()[:4] - run.pose[-1, :2]
    np.testing.assert_allclose(np.hypot(*turned.T), 0.125 * math.sqrt(2.0), rtol=1e-12)
    shade = [outline.get_edgecolor()[0] for outline in outlines]
    assert shade[0] == shade[-1] < min(shade[1:-1])


def test_a_stroke_lies_along_each_rotors_axis():
    surface = sort().run.surface
    strokes = np.array(sort().plot().axes[0].collections[0].get_segments())
    middle, along = strokes.mean(axis=1), strokes[:, 1] - strokes[:, 0]
    column = ((middle[:, 0] - surface.x[0]) / 0.1).round().astype(int)
    row = ((middle[:, 1] - surface.y[0]) / 0.1).round().astype(int)
    assert surface.rotor[row, column].all()
    axis = surface.axis[row, column]
    np.testing.assert_allclose(np.cos(axis) * along[:, 1], np.sin(axis) * along[:, 0], atol=1e-12)


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
@pytest.mark.parametrize(
    "parcel", [BOX, sg.Parcel(sg.Disc(0.2)), sg.Parcel(sg.Rectangle(2.4, 1.2))]
)
@pytest.mark.parametrize("pitch", [0.05, 0.1, (0.2, 0.3)])
def test_all_outlines_are_in_the_window_whatever_the_size(parcel, pitch, tmp_path):
    surface = sg.Surface(np.full((120, 160), 0.3), np.ones((120, 160), dtype=bool), pitch=pitch)
    run = sg.simulate(surface, parcel, (3.0, 3.0, 0.4), (1.0, 0.5, 1.0), duration=0.5)
    figure = run.plot(tmp_path / "run.png")
    way = figure.axes[0]
    assert way.get_aspect() == 1.0
    (left, right), (bottom, top) = way.get_xlim(), way.get_ylim()
    for outline in way.patches:
        x, y = outline.get_xy().T
        assert left < x.min() < x.max() < right
        assert bottom < y.min() < y.max() < top
    assert right - left < 3.0 * (np.ptp(run.pose[:, 0]) + 2.0 * parcel.base.reach + 0.6)
    assert (tmp_path / "run.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("make", "title"),
    [
        (sort, "after 1 s: the duration is over"),
        (
            partial(sg.simulate, sg.layouts.sorting(), BOX, (1.0, 1.0, 0.3), method="explicit"),
            "after 0 s: stopped",
        ),
        (
            partial(sg.simulate, supports(10, 10), BOX, (0.5, 0.5, 0.1), (2.0, 0.0, 0.0)),
            "after 0.25 s: left the surface",
        ),
    ],
    ids=["duration", "one row", "left"],
)
def test_the_title_says_how_it_ended(make, title, tmp_path):
    run = make()
    figure = run.plot(tmp_path / "run.pdf")
    assert figure.get_suptitle() == title
    legend = figure.axes[0].get_legend()
    assert (legend is not None) == run.tipping.any()


def test_a_strip_of_very_many_elements_shows_none():
    start = (sg.Parcel(sg.Disc(0.2)), (1.0, 0.6, 0.0), (18.0, 0.0, 0.0), 10.0)
    run = sg.simulate(supports(12, 4000), *start)
    assert not run.plot().axes[0].collections


def test_without_a_run_the_way_alone_is_drawn(tmp_path):
    run = replace(sort(), run=None)
    way = run.plot(tmp_path / "run.svg").axes[0]
    assert not way.patches
    assert not way.collections
    assert any(np.array_equal(line, run.pose[:, :2]) for line in lines_of(way))


def test_round_off_does_not_look_like_turning():
    run = sg.simulate(supports(20, 30), BOX, (1.0, 1.0, 0.0), (1.0, 0.0, 0.0), duration=0.2)
    assert run.plot().axes[2].get_ylim() == (-0.02, 0.02)


def test_a_suffix_that_is_none_is_refused(tmp_path):
    with pytest.raises(ValueError, match="Format 'txt' is not supported"):
        sort().plot(tmp_path / "run.txt")


def test_without_matplotlib_the_error_says_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, "surface_gym.trajectory_plot", raising=False)
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match=r"needs matplotlib .* pip install 'surface_gym\[tools]'"):
        sort().plot()
