"""`surface-gym design flow`: its flags, and its answer from end to end."""

import json
from pathlib import Path

import pytest

import surface_gym as sg
from surface_gym.agents.scheduling import design
from surface_gym.design import cli
from surface_gym.design.flow_question import parse_exits, parse_mix
from surface_gym.flow.exits import Exit, Exits
from tests.environments import run_python


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
        ("--mix 0.3xa", "each part of mix must be a finite number, got 'a'"),
        ("--exits nowhere", "exits must be sides, chutes, or a list as left:1.0-2.5,right:1.0-"),
        ("--exits left:3-1", "exits must be sides, chutes, or a list as left:1.0-2.5,right:1.0-"),
        ("--exits left:1-2,left:1-2", "exits must have names of their own, got 'left' twice"),
        ("--exits left:7-8", "longest must be at least 7.1 m"),
        ("--speed 1 2 3", "speed must be one number or two, got (1.0, 2.0, 3.0)"),
        ("--speed 2 1", "speed must be the least and then the greatest, got (2.0, 1.0)"),
        ("--speed 0", "speed must be greater than 0, got 0.0"),
        ("--longest 0.3", "longest must be between 0.6 and 50, got 0.3"),
        ("--rate 30000", "rate must be at most 20000 parcels/h"),
        ("--rate 0", "rate must be greater than 0, got 0.0"),
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


def test_its_help_imports_neither_numba_nor_agents():
    code = (
        "import sys\nfrom surface_gym.design import cli\n"
        "try: cli.main(['flow', '--help'])\n"
        "except SystemExit: pass\n"
        "print([x for x in ('numba', 'matplotlib', 'surface_gym.agents') if x in sys.modules])"
    )
    printed = run_python("-c", code)
    assert "--mix" in printed
    assert printed.endswith("[]\n")
