"""The benchmark of transports, as short as it can be: nothing wrong moves an axis."""

import json

from benchmarks.transports import KINDS, main


def test_wrong_messages_do_no_harm_and_a_machine_is_back(tmp_path, capsys) -> None:
    short = ["--periods", "25", "--restarts", "1", "--messages", "100"]
    main([*short, "--json", str(tmp_path / "figures.json")])
    found = json.loads((tmp_path / "figures.json").read_text())["figures"]
    values = {each["name"]: each["value"] for each in found}
    for transport in ("socket", "OPC UA"):
        for kind in KINDS:
            assert values[f"{transport}: {kind}, obeyed out of range"] == 0
        assert values[f"{transport}: commands without effect"] == 0
        assert values[f"{transport}: longest of 1"] > 0.0
    assert all(values[f"OPC UA: {kind}, accepted of 100"] == 0 for kind in KINDS)
    assert "load" in capsys.readouterr().out
