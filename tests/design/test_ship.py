import json
import sys
from functools import partial
from pathlib import Path

import pytest

from surface_gym.design import ship
from surface_gym.design.search import Effort
from surface_gym.design.sorting_layouts import find_sorting_layouts


def test_the_command_writes_what_it_finds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    small = Effort(members=5, generations=1, epochs=1, rounds=0)
    quick = partial(find_sorting_layouts, sizes=("S",), effort=small)
    monkeypatch.setattr(ship, "find_sorting_layouts", quick)
    file, kept = tmp_path / "found.json", tmp_path / "kept"
    flags = ["--file", str(file), "--offers", "four", "--checkpoints", str(kept)]
    monkeypatch.setattr(sys, "argv", ["ship", *flags])
    ship.main()
    (row,) = json.loads(file.read_text())
    assert (row["box"], row["offer"], row["least_speed"]) == ("S", "four", 0.72)
    assert (kept / "S-four.npz").is_file()
    assert capsys.readouterr().out == "S-box, four: sorts from 0.72 m/s on\n"
