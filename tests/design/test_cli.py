"""`surface-gym design`: its flags, and its answers from end to end."""

import csv
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tyro

import surface_gym as sg
from surface_gym.agents.scheduling import design
from surface_gym.design import cli
from surface_gym.design.case import SlowPurpose, SortPurpose, StopPurpose, TurnPurpose, Unknown
from surface_gym.design.cli import AskFriction, parse_exits, parse_mix
from surface_gym.design.fixed_layout import Effort
from surface_gym.design.runs import STEP
from surface_gym.flow.exits import Exit, Exits
from surface_gym.parallel import usable_cores


def asked(*flags: str) -> AskFriction:
    return tyro.cli(AskFriction, args=flags)


def test_purposes():
    for flags, purpose in {
        "": SortPurpose(-1),
        "--side left": SortPurpose(1),
        "--purpose slow": SlowPurpose(0.5),
        "--purpose slow --ratio 0.7 --tolerance 0.1": SlowPurpose(0.7, 0.1),
        "--purpose stop": StopPurpose(),
        "--purpose stop --place 0.4 --tolerance 0.1": StopPurpose(0.4, 0.1),
        "--purpose turn": TurnPurpose(),
        "--purpose turn --angle-deg -20": TurnPurpose(math.radians(-20.0)),
    }.items():
        assert asked("--parcel", "S", *flags.split()).check().purpose == purpose


def test_parcels():
    assert asked("--parcel", "0.3x0.4").check().parcel.base == sg.Rectangle(0.3, 0.4)
    assert asked("--parcel", "B").check().parcel == sg.layouts.box("B")
    assert asked("--disc", "0.2", "--mass", "12").check().parcel == sg.Parcel(sg.Disc(0.2), 12.0)
    base = asked("--polygon", "0,0 0.3,0 0.2,0.25").check().parcel.base
    np.testing.assert_array_equal(base.outline, [[0.0, 0.0], [0.3, 0.0], [0.2, 0.25]])
    loaded = asked("--disc", "0.2", "--com-offset", "0.01", "0.02", "--inertia", "0.3").check()
    assert loaded.parcel.com_offset == (0.01, 0.02)
    assert loaded.parcel.inertia == 0.3


def test_the_surface_and_what_is_unknown():
    case = asked(
        "--parcel", "S", "--pitch", "0.1x0.12", "--tilt-deg", "5", "--friction", "0.1",
        "--unevenness", "0", "--com-spread", "0.2", "--heading-deg", "3", "--mu-max", "0.6",
    ).check()  # fmt: skip
    unknown = case.unknown
    assert (case.pitch, case.mu_max) == ((0.1, 0.12), 0.6)
    assert (case.tilt, unknown.heading) == pytest.approx((math.radians(5.0), math.radians(3.0)))
    assert (unknown.friction, unknown.com_offset) == (0.1, 0.2)
    assert unknown.groups == ("friction", "load", "entry", "together")
    assert asked("--parcel", "S", "--pitch", "0.12").check().pitch == 0.12
    assert asked("--parcel", "S").check().draws == 100
    assert asked().workers == usable_cores() >= 1


def test_an_error_names_the_flag():
    for flags, said in (
        ((), "parcel must be one of --parcel, --disc and --polygon, got none"),
        (("--parcel", "S", "--disc", "0.2"), "got --parcel and --disc"),
        (("--parcel", "0.3"), "parcel must be LxW as 0.3x0.4, S or B, got '0.3'"),
        (("--parcel", "ax0.3"), "each part of parcel must be a finite number, got 'a'"),
        (("--polygon", "0,0 0.3"), "polygon must be 'X,Y X,Y X,Y', got '0,0 0.3'"),
        (("--parcel", "S", "--pitch", "1x2x3"), "pitch must be one number or two"),
        (("--parcel", "S", "--speed", "30"), "speed must be between 0 and 20, got 30.0"),
        (("--parcel", "S", "--ratio", "0.5"), "ratio must not be given to sort"),
        (("--parcel", "S", "--purpose", "slow", "--place", "1"), "place must not be given to slow"),
        (("--parcel", "S", "--purpose", "stop", "--tolerance", "1"), "with --place only"),
        (("--parcel", "S", "--workers", "0"), "workers must be a whole number of at least 1"),
    ):
        with pytest.raises(ValueError, match=re.escape(said)):
            asked(*flags).check()


OWN = ("--parcel", "0.3x0.4", "--speed", "1.2", "--draws", "4", "--workers", "1")
QUICK = {
    "speed": ("--highest", "1.5"),
    "tilt": ("--highest-deg", "3"),
    "layout": (
        "--columns", "6", "--speeds", "1.0", "1.2", "--speed-step", "0.1", "--members", "5",
        "--epochs", "1",
    ),
}  # fmt: skip


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The error of a command that ends with it, in one line."""
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    return line[7:]


@pytest.mark.parametrize("question", sorted(set(cli.QUESTIONS) - {"flow"}))
def test_a_question_is_answered_first_in_a_sentence_then_in_files(question, tmp_path, capsys):
    cli.main([question, *OWN, *QUICK.get(question, ()), "--out", str(tmp_path)])
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


def test_it_says_what_speed_is_assumed_and_that_mass_cancels_where_it_does(tmp_path, capsys):
    flags = ["columns", "--parcel", "S", "--rows", "2", "--draws", "1", "--out", str(tmp_path)]
    for given in ([], ["--speed", "1.0"]):
        cli.main([*flags, *given])
        first = capsys.readouterr().out.splitlines()[0]
        assert first.endswith("an entry speed of 1 m/s is assumed.") == (not given)
    flags = [*OWN, "--mass", "12", "--out", str(tmp_path)]
    cli.main(["columns", *flags, "--rows", "4"])
    first, second = capsys.readouterr().out.splitlines()[:2]
    assert ": 6 columns of 4 rows (24 modules at +45 deg) suffice" in first
    assert second.startswith("Mass cancels out of the motion")
    cli.main(["columns", *flags, "--rows", "4", "--inertia", "0.3"])
    assert "cancels" not in capsys.readouterr().out


def test_a_question_that_is_stopped_says_so(tmp_path, monkeypatch, capsys):
    class Stopping(cli.Progress):
        """A bar at which somebody presses Ctrl-C."""

        def update(self, *_: object, **__: object) -> None:
            raise KeyboardInterrupt

    monkeypatch.setattr(cli, "Progress", Stopping)
    with pytest.raises(SystemExit) as ended:
        cli.main(["friction", *OWN, "--out", str(tmp_path)])
    assert (ended.value.code, capsys.readouterr().err) == (cli.STOPPED, "stopped\n")


def test_a_refused_question_is_one_line_and_makes_no_folder(tmp_path, capsys):
    folder = tmp_path / "none"
    wrong = ("friction", "--parcel", "S", "--ratio", "0.5", "--out", str(folder))
    assert refused(capsys, *wrong).startswith("ratio must not be given to sort")
    assert not folder.exists()
    for arguments, error in (
        (("friction", "--parcel", "S", "--speed", "0.3"), "columns must be given"),
        (("columns", *OWN, "--columns", "3"), "columns must not be given: they are what is asked"),
        (("layout", *OWN, "--speeds", "2", "1"), "speeds must be the least and the most, got (2.0"),
    ):
        assert refused(capsys, *arguments, "--out", str(folder)).startswith(error)
    (tmp_path / "file").write_text("")
    assert "file" in refused(capsys, "columns", *OWN, "--out", str(tmp_path / "file"))


# Streams of parcels.


def test_a_mix_has_names_sizes_and_odds():
    assert parse_mix("S") == (("S", 1.0),)
    own = sg.Parcel(sg.Rectangle(0.3, 0.4))
    assert parse_mix("S=3, B, 0.3x0.4=0.5") == (("S", 3.0), ("B", 1.0), (own, 0.5))


def test_exits_are_a_preset_or_a_list():
    assert parse_exits("chutes") == "chutes"
    listed = parse_exits("left 1:1.0-2.5, left 2:3-4,right:1.0-2.5,straight")
    spans = Exit("left 1", 1, 1.0, 2.5), Exit("left 2", 1, 3.0, 4.0), Exit("right", -1, 1.0, 2.5)
    assert listed == Exits((*spans, Exit("straight", 0)))


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("--mix Q=1", "mix must be S, B or LENGTHxWIDTH in m, with odds, as S=1,B=2,0.3x0.4, got "),
        ("--mix S=x", "odds of mix must be a finite number, got 'x'"),
        ("--exits nowhere", "exits must be sides, chutes, or a list as left:1.0-2.5,right:1.0-"),
        ("--exits left:3-1", "exits must be sides, chutes, or a list as left:1.0-2.5,right:1.0-"),
        ("--exits left:1-2,left:1-2", "exits must have names of their own, got 'left' twice"),
        ("--exits left:7-8", "longest must be at least 7.1 m"),
        ("--speed 1 2 3", "speed must be one number or two, got (1.0, 2.0, 3.0)"),
        ("--speed 2 1", "speed must be the least and then the greatest, got (2.0, 1.0)"),
        ("--longest 0.3", "longest must be between 0.6 and 50, got 0.3"),
        ("--rate 30000", "rate must be at most 20000 parcels/h"),
        ("--workers 0", "workers must be a whole number of at least 1, got 0"),
    ],
)
def test_a_wrong_flag_is_named_in_one_line_and_no_folder_is_made(flags, said, tmp_path, capsys):
    folder = tmp_path / "none"
    with pytest.raises(SystemExit) as ended:
        cli.main(["flow", "--rate", "9000", *flags.split(), "--out", str(folder)])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {said}")
    assert not folder.exists()


def test_it_answers_in_a_sentence_tables_a_picture_and_json(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(design, "REPLICATIONS", 2)
    monkeypatch.setattr(design, "SECONDS", 10.0)
    file = tmp_path / "flow.json"
    flags = ("--rate", "5000", "--speed", "1", "--longest", "1.1", "--workers", "1")
    cli.main(["flow", *flags, "--out", str(tmp_path), "--json", str(file)])
    first, *rest = capsys.readouterr().out.splitlines()
    assert first.startswith("To carry 5000 parcels an hour, the shortest line is ")
    written = [Path(line) for line in rest if line.startswith(str(tmp_path))]
    assert file in written
    assert tmp_path / "flow.png" in written
    lines = json.loads(file.read_text())["lines"]
    assert {line["hardware"] for line in lines} == set(design.HARDWARE)
    able = [line for line in lines if line["carries"]]
    assert all(line["predicted"] >= 5000.0 for line in able)
    assert min(line["actuators"] for line in able) == 1


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def test_flags_have_the_defaults_of_what_they_set():
    """They are written down again, so that help imports little."""
    question = AskFriction(parcel="S")
    assert question.check().unknown == Unknown()
    assert question.step == STEP
    layout = cli.AskLayout()
    assert (layout.members, layout.epochs) == (Effort.members, Effort.epochs)


def test_neither_the_package_nor_its_help_imports_what_is_heavy():
    heavy = ("matplotlib", "rich", "torch", "tyro", "agents")
    done = run(
        "import sys, surface_gym.design\n"
        f"print([name for name in {heavy!r} if name in sys.modules])\n"
        "from surface_gym.design import cli\n"
        "try: cli.main(['layout', '--help'])\n"
        "except SystemExit: pass\n"
        "try: cli.main(['flow', '--help'])\n"
        "except SystemExit: pass\n"
        "print([x for x in ('numba', 'matplotlib', 'surface_gym.agents') if x in sys.modules])"
    )
    assert done.stdout.startswith("[]\n"), done.stderr
    assert "--mix" in done.stdout
    assert done.stdout.endswith("[]\n")


def test_a_missing_matplotlib_is_reported_before_anything_is_computed(tmp_path):
    done = run(
        "import runpy, sys; sys.modules['matplotlib'] = None; "
        f"sys.argv = ['it', 'columns', '--parcel', 'S', '--out', {str(tmp_path / 'none')!r}]; "
        "runpy.run_module('surface_gym.design', run_name='__main__')"
    )
    assert "needs matplotlib, which is not installed: pip install" in done.stderr
    assert not (tmp_path / "none").exists()
