"""The study: the methods' speed, its report and its command line."""

import json
import sys

import numpy as np
import pytest
from rich.console import Console

import surface_gym as sg
from surface_gym import validation
from surface_gym.validation import command, drawn, study
from surface_gym.validation.report import as_data, draw_all, print_report

from .test_comparison import trajectory


@pytest.fixture(scope="module")
def found(tilted, pushed):
    """Two real runs; the other parts are numbers to print."""
    draws = drawn.draw_surfaces(draws=2, seed=0)
    rng = np.random.default_rng(0)
    return study.Study(
        sweep=(tilted,),
        pushed=pushed,
        long=tilted,
        convergence=study.compare_variants([np.zeros(3) for _ in study.JOBS]),
        speeds=(study.Speed("implicit", 3e-3, 0.72, 7000.0),),
        spreads=drawn.compare_draws(draws, [rng.normal(size=(2, 3)) for _ in draws]),
        meetings=tuple(
            drawn.MeetingRun(drawn.Meeting(k), rng.normal(size=(2, 2, 3)), np.eye(2, 3), k == 1)
            for k in range(3)
        ),
    )


def test_speed_is_taken_at_the_largest_step_up_to_which_all_are_accurate():
    method = study.Method(
        "linear",
        lambda _, step: trajectory(*np.full(3, 2.0 if step == 0.5 else 1.0 + step)),
        fine=0.0,
        steps=(0.001, 0.009, 0.5, 0.002),
    )
    measured = study.measure(method)
    assert measured.step == 0.009
    assert measured.error == pytest.approx(0.9)
    assert measured.rate > 0.0
    method = study.Method("bad", lambda _, step: trajectory(*np.full(3, 1 + step)), 0.0, (0.5,))
    with pytest.raises(ValueError, match=r"steps of bad must hold one .* got 50.00 % at 0.5 s"):
        study.measure(method)


def test_the_report_holds_every_part(found, tmp_path):
    with (tmp_path / "report").open("w") as file:
        print_report(found, Console(file=file, width=80))
    text = (tmp_path / "report").read_text()
    for part in (
        "Adams / MATLAB, printed", "MuJoCo 10 deg", "3 drawn meetings", "implicit, 5 ms",
        "1 of them tip in MuJoCo", "What this cannot show: the base is flat",
    ):  # fmt: skip
        assert part in text
    assert text.count("reached") == 9
    assert "…" not in text  # nothing is cut off at 80 columns


def test_the_data_is_json_and_every_figure_is_drawn(found, tmp_path):
    data = json.loads(json.dumps(as_data(found)))
    assert data["runs"][0]["mujoco"] == pytest.approx([0.451, -0.214, -26.4], rel=0.01)
    assert [target["reached"] for target in data["targets"]] == [True] * 9
    assert len(data["uneven_supports"]) == len(drawn.CASES) * len(drawn.UNEVEN)
    assert [each["tips_in_mujoco"] for each in data["meetings"]] == [False, True, False]
    np.testing.assert_allclose(data["meetings"][2]["error_mm_mm_deg"], found.meetings[2].analytic)
    paths = draw_all(found, tmp_path)
    figures = [f"figure{k}" for k in range(12, 17)]
    assert [path.stem for path in paths] == [*figures, "uneven_supports"]
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


def test_without_mujoco_the_error_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    what_to_do = r"pip install 'surface_gym\[validation\]'"
    with pytest.raises(ImportError, match=what_to_do):
        validation.simulate(sg.layouts.sorting(), sg.Parcel(sg.Disc(0.1)), (0.125, 1.0, 0.0))
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
    for option in ("figures", "json", "heights", "touching", "workers", "tilts", "seed"):
        assert f"--{option}" in shown
