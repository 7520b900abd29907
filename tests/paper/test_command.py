import json

import pytest

from surface_gym.paper import command

FIGURES = (*(f"figure{k}" for k in range(6, 12)), "alignment")


@pytest.fixture
def computed(monkeypatch, reproduction):
    """The command with its numbers already computed."""
    monkeypatch.setattr(command, "reproduce", lambda _track: reproduction)


@pytest.fixture
def forbidden(monkeypatch):
    """The command with the work it must not begin."""

    def reproduce(_track):
        pytest.fail("worked before it looked whether the result can be written")

    monkeypatch.setattr(command, "reproduce", reproduce)


@pytest.mark.usefixtures("computed")
def test_the_report_shows_every_table_and_count(reproduction, capsys):
    command.main([])

    out = capsys.readouterr().out
    for table in reproduction.tables:
        assert table.title in out
    assert "39 of 40 at 5 ms, 38 of 40 converged" in out
    assert "37 of 38 at 5 ms, 34 of 38 converged" in out
    assert "The paper prints no step" in out
    assert out.count("steps in which Eq. (1) has no solution:") == len(reproduction.tables)
    assert "The most that one step brings is 88, at 4 and 5 and 6 ms" in out
    assert "paper's step" not in out
    assert "S-box by tilt: 11 of 11, 11 of 11" in out
    assert all(len(line) <= 80 for line in out.splitlines())


@pytest.mark.usefixtures("computed")
def test_json_holds_what_was_computed(reproduction, tmp_path):
    file = tmp_path / "report.json"

    command.main(["--json", str(file)])

    report = json.loads(file.read_text("utf-8"))
    assert list(report["tables"]) == [table.key for table in reproduction.tables]
    for table in reproduction.tables:
        written = report["tables"][table.key]
        assert written["agreeing"] == [table.agreeing(k) for k in range(3)]
        for cell, row in zip(table.cells, written["cells"], strict=True):
            values = [list(f.value) if isinstance(f.value, tuple) else f.value for f in cell.ours]
            assert [each["value"] for each in row["ours"]] == values
            assert [each["tipping"] for each in row["ours"]] == [f.tipping for f in cell.ours]
            assert row["agrees"] == [cell.agrees(k) for k in range(3)]
    rates = [case["ours"][1]["rate"] for case in report["sorting_rates"]["by_speed"]]
    assert rates == [case.ours[1].rate for case in reproduction.sorted_by_speed]
    assert len(report["agreeing_by_step"]) == len(reproduction.by_step)
    assert len(report["self_stopping"]) == len(reproduction.self_stopping)
    assert len(report["alignment"]) == len(reproduction.alignment)


@pytest.mark.usefixtures("computed")
def test_figures_are_drawn(tmp_path, capsys):
    folder = tmp_path / "new" / "figures"

    command.main(["--figures", str(folder)])

    printed = capsys.readouterr().out
    for name in FIGURES:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert str(folder / f"{name}.png") in printed


@pytest.mark.usefixtures("forbidden")
@pytest.mark.parametrize("option", ["--json", "--figures"])
def test_a_path_that_cannot_be_written_is_told_before_the_work(option, tmp_path):
    file = tmp_path / "file"
    file.touch()

    with pytest.raises(SystemExit, match=r"cannot write .*below"):
        command.main([option, str(file / "below")])


@pytest.mark.usefixtures("forbidden")
def test_a_folder_is_no_json_file(tmp_path):
    with pytest.raises(SystemExit, match="cannot write"):
        command.main(["--json", str(tmp_path)])


@pytest.mark.usefixtures("forbidden")
def test_an_unknown_option_is_refused(capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(["--tables"])

    assert stop.value.code == 2
    assert "--tables" in capsys.readouterr().err


def test_help_names_the_options(capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(["--help"])

    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert "--figures DIR" in out
    assert "--json FILE" in out
