"""`python -m surface_gym.design`, from end to end."""

import csv
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from surface_gym.design import command

OWN = ("--parcel", "0.3x0.4", "--speed", "1.2", "--draws", "4", "--workers", "1")
QUICK = {
    "columns": (),
    "speed": ("--highest", "1.5"),
    "tilt": ("--highest-deg", "3"),
    "friction": (),
    "map": ("--cells", "3"),
    "sensitivity": (),
    "layout": (
        "--columns", "6", "--speeds", "1.0", "1.2", "--speed-step", "0.1", "--members", "5",
        "--epochs", "1",
    ),
}  # fmt: skip


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that a command ends with."""
    with pytest.raises(SystemExit) as ended:
        command.main(arguments)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


@pytest.mark.parametrize("question", QUICK)
def test_a_question_is_answered_first_in_a_sentence_then_in_files(
    question: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command.main([question, *OWN, *QUICK[question], "--out", str(tmp_path)])
    first, *rest = capsys.readouterr().out.splitlines()
    assert first.endswith(".")
    assert "columns of 4 rows" in first
    written = [Path(line) for line in rest if line.startswith(str(tmp_path))]
    assert tmp_path / f"{question}.png" in written
    tables = [path for path in written if path.suffix == ".csv"]
    assert tables
    for table in tables:
        with table.open(newline="") as file:
            header, *rows = csv.reader(file)
        assert rows
        assert all(len(row) == len(header) for row in rows)


def test_every_question_is_tried_above() -> None:
    assert set(QUICK) == set(command.QUESTIONS) - {"control"}


def test_the_columns_of_the_issue(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """How many columns for a 0.3 x 0.4 m parcel of 12 kg at 1.2 m/s."""
    command.main(["columns", *OWN, "--mass", "12", "--rows", "4", "--out", str(tmp_path)])
    first, second = capsys.readouterr().out.splitlines()[:2]
    assert first.startswith("6 columns of 4 rows (24 modules at +45 deg)")
    assert second.startswith("Mass cancels out of the motion")


def test_mass_is_not_said_to_cancel_where_it_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command.main(["sensitivity", *OWN, "--mass", "12", "--inertia", "0.3", "--out", str(tmp_path)])
    assert "cancels" not in capsys.readouterr().out


def test_answers_do_not_depend_on_the_workers(tmp_path: Path) -> None:
    for workers in ("1", "2"):
        command.main(
            ["sensitivity", *OWN[:-1], workers, "--columns", "6", "--out", str(tmp_path / workers)]
        )
    one, two = ((tmp_path / workers / "sensitivity.csv").read_text() for workers in ("1", "2"))
    assert one == two


def test_a_map_that_is_stopped_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["map", *OWN, "--cells", "3", "--out", str(tmp_path)]
    monkeypatch.setattr(command, "Progress", stopping_after(20))
    with pytest.raises(SystemExit) as ended:
        command.main(flags)
    assert ended.value.code == command.STOPPED
    assert capsys.readouterr().err == "stopped; --resume goes on\n"
    monkeypatch.undo()

    before = np.load(tmp_path / "map.npz")["found"]
    assert np.isnan(before).any()
    assert not np.isnan(before).all()
    command.main([*flags, "--resume"])
    resumed = (tmp_path / "map.csv").read_text()
    command.main(flags)
    assert resumed == (tmp_path / "map.csv").read_text()


def stopping_after(runs: int) -> Callable[..., object]:
    """A bar at which somebody presses Ctrl-C when so many runs are done."""

    class Stopping(command.Progress):
        def update(self, *_: object, completed: float, **__: object) -> None:  # type: ignore[override]
            if completed > runs:
                raise KeyboardInterrupt

    return Stopping


def test_a_question_that_keeps_nothing_just_stops(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "Progress", stopping_after(0))
    with pytest.raises(SystemExit):
        command.main(["sensitivity", *OWN, "--out", str(tmp_path)])
    assert capsys.readouterr().err == "stopped\n"


def test_resuming_another_map_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["map", *OWN, "--cells", "2", "--columns", "6", "--out", str(tmp_path)]
    command.main(flags)
    capsys.readouterr()
    line = refused(capsys, *flags, "--resume", "--seed", "1")
    assert line.startswith("error: checkpoint must be of this map")
    assert line.endswith("another seed: 0, not 1")


def test_a_flag_that_is_not_allowed_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ("--out", str(tmp_path / "none"))
    line = refused(capsys, "friction", "--parcel", "S", "--ratio", "0.5", *out)
    assert line == "error: ratio must not be given to sort"
    assert not (tmp_path / "none").exists()
    line = refused(capsys, "friction", "--parcel", "S", "--speed", "0.3", *out)
    assert line.startswith("error: columns must be given")


def test_what_a_question_cannot_be_given_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ("--out", str(tmp_path))
    line = refused(capsys, "columns", *OWN, "--columns", "3", *out)
    assert line == "error: columns must not be given: they are what is asked for"
    line = refused(capsys, "layout", *OWN, "--speeds", "2", "1", *out)
    assert line == "error: speeds must be the least and the most, got (2.0, 1.0)"
    line = refused(capsys, "map", *OWN, "--cells", "0", *out)
    assert line == "error: cells must be a whole number of at least 1, got 0"


def test_a_folder_that_cannot_be_made_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    line = refused(capsys, "columns", *OWN, "--out", str(tmp_path / "file"))
    assert line.startswith("error: ")
    assert "file" in line


HEAVY = ("matplotlib", "rich", "torch", "tyro", "agents")


def test_the_package_asks_for_none_of_them() -> None:
    code = (
        "import sys, surface_gym.design\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    import surface_gym.design as design

    assert all(hasattr(design, name) for name in design.__all__)
    assert callable(design.least_columns)
    assert callable(design.sensitivity)
    assert callable(design.best_layout)
