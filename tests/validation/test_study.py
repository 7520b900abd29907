"""Errors of Eq. (5), the paper's numbers, the methods' speed, the report and the command."""

import json
import sys

import numpy as np
import pytest
from rich.console import Console

import surface_gym as sg
from surface_gym import validation
from surface_gym.paper.runs import displacement
from surface_gym.trajectory import Trajectory
from surface_gym.validation import __main__ as command, comparison, drawn, report
from surface_gym.validation.comparison import IMPLICIT, MUJOCO, ComparedRun, Errors, compute_errors


def trajectory(*displacement: float) -> Trajectory:
    x, y, theta = displacement
    pose = np.array([[0.0, 0.0, 0.0], [x, y, np.radians(theta)]])
    return Trajectory(np.array([0.0, 1.0]), pose, np.zeros((2, 3)), np.zeros(2, bool), "duration")


def test_errors_are_those_of_eq_5_and_a_summary_is_mean_and_sample_deviation():
    mujoco, implicit = trajectory(0.5, -0.2, -20.0), trajectory(0.49, -0.21, -21.0)
    run = ComparedRun(comparison.PUSHED, {MUJOCO: mujoco, IMPLICIT: implicit})
    error = compute_errors([run], IMPLICIT)
    np.testing.assert_allclose(error.absolute, [[10.0, 10.0, 1.0]])
    np.testing.assert_allclose(error.percent, [[2.0, -5.0, -5.0]])
    rows = np.array([[1.0, 0.0, -1.0], [3.0, 0.0, -3.0]])
    summary = Errors(10.0 * rows, rows).summary()
    np.testing.assert_allclose(summary.percent, [[2.0, 0.0, -2.0], [2**0.5, 0.0, 2**0.5]])
    np.testing.assert_allclose(summary.absolute, 10.0 * summary.percent)


def test_the_papers_numbers_are_read():
    paper = comparison.load_paper_errors()
    np.testing.assert_array_equal(paper.table7.percent, [[0.02, 1.41, -4.47], [0.44, 3.48, 4.36]])
    np.testing.assert_array_equal(paper.table7.absolute, [[0.12, 0.25, 0.96], [1.5, 5.2, 1.02]])
    np.testing.assert_allclose(paper.pushed.absolute, [[3.0, 3.7, 1.56]])
    assert paper.sorts_from == 9.5


def test_the_sort_completes_from_the_least_tilt_above_which_all_do(tilted):
    assert comparison.sorts_from([tilted], MUJOCO) == 10.0
    stays = trajectory(0.0, 0.0, 0.0)
    stays.pose[:, :2] += tilted.by[MUJOCO].pose[0, :2]
    still = ComparedRun(tilted.case, {MUJOCO: stays})
    assert comparison.sorts_from([still], MUJOCO) is None


@pytest.mark.parametrize(
    ("run", "errors", "percents"),
    [
        ("gamma10", (0.0011, 0.0001, 1.735), (0.24, 0.05, 7.06)),
        ("v09", (0.003, 0.0037, 1.56), (0.65, 1.59, 6.97)),
    ],
)
def test_a_displacement_of_adams_is_the_error_over_its_share(run, errors, percents):
    low, high = comparison.adams_displacement(run)
    exact = 100.0 * np.array(errors) / np.array(percents)
    assert (low < exact).all()
    assert (exact < high).all()
    if run == "gamma10":  # 1.735 deg stands for 1.7345 to 1.7355, 7.06 % for 7.055 to 7.065
        assert low[2] == pytest.approx(100.0 * 1.7345 / 7.065)
        assert high[2] == pytest.approx(100.0 * 1.7355 / 7.055)


def test_mujoco_ends_where_adams_does_as_far_as_is_printed(tilted):
    moved = np.abs(displacement(tilted.by[MUJOCO]))
    low, high = comparison.adams_displacement("gamma10")
    assert (low < moved)[:2].all()
    assert (moved < high)[:2].all()
    assert abs(moved[2] - low[2]) < 2.0


@pytest.fixture(scope="module")
def found(tilted, pushed):
    """Two real runs; the other parts are numbers to print."""
    draws = drawn.draw_surfaces(draws=2, seed=0)
    rng = np.random.default_rng(0)
    return report.Study(
        sweep=(tilted,),
        pushed=pushed,
        long=tilted,
        convergence=comparison.compare_variants([np.zeros(3) for _ in comparison.JOBS]),
        speeds=(comparison.MethodSpeed("implicit", 3e-3, 0.72, 7000.0),),
        spreads=drawn.compare_draws(draws, [rng.normal(size=(2, 3)) for _ in draws]),
        meetings=tuple(
            drawn.TouchingRun(k, rng.normal(size=(2, 2, 3)), np.eye(2, 3), k == 1) for k in range(3)
        ),
        crowds=tuple(
            drawn.TouchingRun(k, rng.normal(size=(2, 7, 3)), np.ones((7, 3)), k == 1)
            for k in range(2)
        ),
    )


def test_speed_is_taken_at_the_largest_step_up_to_which_all_are_accurate():
    method = comparison.TimedMethod(
        "linear",
        lambda _, step: trajectory(*np.full(3, 2.0 if step == 0.5 else 1.0 + step)),
        fine=0.0,
        steps=(0.001, 0.009, 0.5, 0.002),
    )
    measured = comparison.measure(method)
    assert measured.step == 0.009
    assert measured.error == pytest.approx(0.9)
    assert measured.rate > 0.0
    method = comparison.TimedMethod(
        "bad", lambda _, step: trajectory(*np.full(3, 1 + step)), 0.0, (0.5,)
    )
    with pytest.raises(ValueError, match=r"steps of bad must hold one .* got 50.00 % at 0.5 s"):
        comparison.measure(method)


def test_the_report_holds_every_part(found, tmp_path):
    with (tmp_path / "report").open("w") as file:
        report.print_report(found, Console(file=file, width=80))
    text = (tmp_path / "report").read_text()
    for part in (
        "Adams / MATLAB, printed", "MuJoCo 10 deg", "3 drawn meetings", "implicit, 5 ms",
        "1 of them tip in MuJoCo", "2 drawn, 14 parcels", "What this cannot show: the base is flat",
    ):  # fmt: skip
        assert part in text
    assert "…" not in text  # nothing is cut off at 80 columns


def test_the_data_is_json_and_every_figure_is_drawn(found, tmp_path):
    data = json.loads(json.dumps(report.as_data(found)))
    assert data["runs"][0]["mujoco"] == pytest.approx([0.451, -0.214, -26.4], rel=0.01)
    assert len(data["uneven_supports"]) == len(drawn.CASES) * len(drawn.UNEVEN)
    assert [each["tips_in_mujoco"] for each in data["meetings"]] == [False, True, False]
    np.testing.assert_allclose(data["meetings"][2]["error_mm_mm_deg"], found.meetings[2].analytic)
    np.testing.assert_allclose(data["crowds"][1]["error_mm_mm_deg"], found.crowds[1].analytic)
    paths = report.draw_all(found, tmp_path)
    assert [path.stem for path in paths] == [f"figure{k}" for k in (14, 15, 16)]
    assert all(path.stat().st_size > 10_000 for path in paths)


@pytest.mark.usefixtures("mujoco")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tilts", "5", "20"], "error: tilts must be between 5 and 15, got 20.0"),
        (["--tilts", "nan"], "error: tilts must be a finite number, got nan"),
        (["--workers", "0"], "error: workers must be a whole number of at least 1, got 0"),
        (["--json", "no/such/folder/file"], "error: [Errno 2] No such file"),
        (["--figures", __file__], "error: [Errno 17] File exists"),
    ],
)
def test_bad_options_end_in_one_line(arguments, message, capsys):
    check_error(arguments, message, capsys)


def test_without_mujoco_it_says_what_to_install_and_help_names_every_option(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install 'surface_gym\[validation\]'"):
        validation.simulate(sg.layouts.sorting(), sg.Parcel(sg.Disc(0.1)), (0.125, 1.0, 0.0))
    check_error([], "error: the validation needs MuJoCo", capsys)
    with pytest.raises(SystemExit) as stop:
        command.main(["--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    for option in ("figures", "json", "heights", "touching", "workers", "tilts", "seed"):
        assert f"--{option}" in shown


def check_error(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(arguments)
    captured = capsys.readouterr()
    assert stop.value.code == 2
    assert captured.err.startswith(message)
    assert captured.err.count("\n") == 1
    assert captured.out == ""
