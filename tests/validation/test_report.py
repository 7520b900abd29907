"""The study: its figures of merit, its report and its command line."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from surface_gym.trajectory import Trajectory
from surface_gym.validation import command, convergence, speed, unevenness
from surface_gym.validation.comparison import Errors, errors, paper_errors, sorts_from, targets
from surface_gym.validation.export import as_data
from surface_gym.validation.report import show
from surface_gym.validation.study import Study


def trajectory(*displacement: float) -> Trajectory:
    x, y, theta = displacement
    pose = np.array([[0.0, 0.0, 0.0], [x, y, np.radians(theta)]])
    return Trajectory(np.array([0.0, 1.0]), pose, np.zeros((2, 3)), np.zeros(2, bool), "duration")


@pytest.fixture(scope="module")
def study(tilted, pushed) -> Study:
    """Two real runs; the other parts are numbers to print."""
    draws = unevenness.jobs(draws=2, seed=0)
    rng = np.random.default_rng(0)
    return Study(
        sweep=(tilted,),
        pushed=pushed,
        long=tilted,
        convergence=convergence.variants([np.zeros(3) for _ in convergence.JOBS]),
        speeds=(speed.Speed("implicit", 3e-3, 0.72, 7000.0),),
        spreads=unevenness.spreads(draws, [rng.normal(size=(2, 3)) for _ in draws]),
    )


def test_errors_are_those_of_eq_5(tilted):
    run = type(tilted)(
        tilted.case, trajectory(0.5, -0.2, -20.0), trajectory(0.49, -0.21, -21.0), tilted.explicit
    )
    error = errors([run], lambda run: run.implicit)
    np.testing.assert_allclose(error.absolute, [[10.0, 10.0, 1.0]])
    np.testing.assert_allclose(error.percent, [[2.0, -5.0, -5.0]])


def test_a_summary_is_mean_and_sample_deviation():
    rows = np.array([[1.0, 0.0, -1.0], [3.0, 0.0, -3.0]])
    summary = Errors(10.0 * rows, rows).summary("")
    np.testing.assert_allclose(summary.percent, [[2.0, 0.0, -2.0], [2**0.5, 0.0, 2**0.5]])
    np.testing.assert_allclose(summary.absolute, 10.0 * summary.percent)


def test_targets_take_the_worst_run_and_the_mean_of_the_sweep():
    sweep = Errors(
        np.array([[1.0, -2.0, 0.5], [-3.0, 1.0, 0.5]]), np.array([[0.5] * 3, [-0.7] * 3])
    )
    pushed = Errors(np.array([[0.0, 6.0, 0.0]]), np.zeros((1, 3)))
    measured = [target.measured for target in targets(sweep, pushed)]
    np.testing.assert_allclose(measured, [3.0, 6.0, 0.5, 0.7, 0.7, 0.7, 0.1, 0.1, 0.1])
    assert [target.what for target in targets(sweep, pushed) if not target.is_reached] == [
        "worst run in y"
    ]


def test_the_papers_numbers_are_read_from_its_tables():
    paper = paper_errors()
    np.testing.assert_array_equal(paper.table7.percent, [[0.02, 1.41, -4.47], [0.44, 3.48, 4.36]])
    np.testing.assert_array_equal(paper.table7.absolute, [[0.12, 0.25, 0.96], [1.5, 5.2, 1.02]])
    np.testing.assert_allclose(paper.pushed.absolute, [[3.0, 3.7, 1.56]])
    assert paper.sorts_from == 9.5


def test_the_sort_completes_from_the_least_tilt_above_which_all_do(tilted):
    assert sorts_from([tilted], lambda run: run.mujoco) == 10.0
    stays = trajectory(0.0, 0.0, 0.0)
    stays.pose[:, :2] += tilted.mujoco.pose[0, :2]
    assert sorts_from([tilted], lambda _: stays) is None


def test_speed_is_taken_at_the_largest_step_up_to_which_all_are_accurate():
    method = speed.Method(
        "linear",
        lambda _, step: trajectory(*np.full(3, 2.0 if step == 0.5 else 1.0 + step)),
        fine=0.0,
        steps=(0.001, 0.009, 0.5, 0.002),
    )
    measured = speed.measure(method)
    assert measured.step == 0.009
    assert measured.error == pytest.approx(0.9)
    assert measured.rate > 0.0


def test_no_accurate_step_is_an_error():
    method = speed.Method("bad", lambda _, step: trajectory(*np.full(3, 1 + step)), 0.0, (0.5,))
    with pytest.raises(ValueError, match=r"steps of bad must hold one .* got 50.00 % at 0.5 s"):
        speed.measure(method)


def test_the_report_holds_every_part(study, tmp_path):
    with (tmp_path / "report").open("w") as file:
        show(study, Console(file=file, width=80))
    text = (tmp_path / "report").read_text()
    assert "Adams / MATLAB, printed" in text
    assert text.count("reached") == 9
    assert "MuJoCo 10 deg" in text
    assert "What this cannot show: the base is flat" in text
    assert "…" not in text  # nothing is cut off at 80 columns


def test_the_data_is_json(study):
    data = json.loads(json.dumps(as_data(study)))
    assert data["runs"][0]["mujoco"] == pytest.approx([0.451, -0.214, -26.4], rel=0.01)
    assert [target["reached"] for target in data["targets"]] == [True] * 9
    assert len(data["uneven_supports"]) == len(unevenness.CASES) * len(unevenness.UNEVEN)


def test_every_figure_is_drawn(study, tmp_path):
    from surface_gym.validation.figures import draw_all

    paths = draw_all(study, tmp_path)
    assert [path.stem for path in paths] == [
        *(f"figure{k}" for k in range(12, 17)),
        "uneven_supports",
    ]
    assert all(path.stat().st_size > 10_000 for path in paths)


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
    pytest.importorskip("mujoco", reason="MuJoCo, of the extra `validation`, is not installed")
    check_error(arguments, message, capsys)


def test_a_missing_mujoco_ends_in_one_line(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    check_error([], "error: the validation needs MuJoCo", capsys)


def check_error(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(arguments)
    captured = capsys.readouterr()
    assert stop.value.code == 2
    assert captured.err.startswith(message)
    assert captured.err.count("\n") == 1
    assert captured.out == ""


def test_help_names_every_option(capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(["--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    for option in ("--figures", "--json", "--heights", "--workers", "--tilts", "--seed"):
        assert option in shown


def test_the_package_carries_the_papers_tables():
    import surface_gym.paper

    assert (Path(surface_gym.paper.__file__).parent / "data" / "targets.json").is_file()
