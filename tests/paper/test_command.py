import json

import pytest

from surface_gym.paper import command

FIGURES = (*(f"figure{k}" for k in range(6, 11)), "alignment")
REPRODUCE = "surface_gym.paper.reproduction.reproduce"


@pytest.fixture
def computed(monkeypatch, reproduction):
    """The command with its numbers already computed."""
    monkeypatch.setattr(REPRODUCE, lambda _track: reproduction)


@pytest.fixture
def forbidden(monkeypatch):
    """The command with the work it must not begin."""
    monkeypatch.setattr(REPRODUCE, lambda _track: pytest.fail("worked before it checked the path"))


@pytest.mark.usefixtures("computed")
def test_the_report_the_data_and_the_figures_hold_everything(reproduction, tmp_path, capsys):
    file, folder = tmp_path / "report.json", tmp_path / "new" / "figures"
    command.main(["--json", str(file), "--figures", str(folder)])
    out = capsys.readouterr().out
    printed, paths = out[: out.index(str(folder))], out[out.index(str(folder)) :]
    for table in reproduction.tables:
        assert table.title in printed
    assert "39 of 40 at 5 ms, 38 of 40 converged" in printed
    assert "37 of 38 at 5 ms, 34 of 38 converged" in printed
    assert "The paper prints no step" in printed
    assert printed.count("steps in which Eq. (1) has no solution:") == len(reproduction.tables)
    assert "The most that one step brings is 88, at 4 and 5 and 6 ms" in printed
    assert "S-box by tilt: 11 of 11, 11 of 11" in printed
    assert "…" not in printed  # nothing is cut off
    assert all(len(line) <= 80 for line in printed.splitlines())
    for name in FIGURES:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert str(folder / f"{name}.png") in paths
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


@pytest.mark.usefixtures("forbidden")
@pytest.mark.parametrize(
    ("option", "path"), [("--json", "file/below"), ("--figures", "file/below"), ("--json", ".")]
)
def test_a_path_that_cannot_be_written_ends_it_before_the_work(option, path, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match=f"^error: cannot write {tmp_path}"):
        command.main([option, str(tmp_path / path)])


@pytest.mark.usefixtures("forbidden")
def test_an_unknown_option_is_refused_and_help_names_the_options(capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(["--tables"])
    assert stop.value.code == 2
    assert "--tables" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        command.main(["--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert "--figures DIR" in out
    assert "--json FILE" in out
