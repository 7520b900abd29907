"""`evaluate.py` on streams of parcels: from cells that are there to the page."""

import io
import json
import re
from pathlib import Path

import pytest
from rich.console import Console

from agents.evaluation import command
from agents.evaluation.command import FLOW, EvaluateConfig, evaluate
from agents.flow import study
from surface_gym.tasks import TASKS
from tests.agents.flow.cells import RULES, flow_cells


def test_flows_are_compared_first_unless_told_otherwise() -> None:
    assert EvaluateConfig().tasks == (FLOW, *TASKS)
    with pytest.raises(ValueError, match=r"tasks must be one of 'flow', .*, got 'juggle'"):
        EvaluateConfig(tasks=("juggle",))


def test_what_is_there_becomes_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "flow_contenders", lambda: RULES)
    monkeypatch.setattr("agents.flow.showing.FILMED", 0.2)
    monkeypatch.setattr("agents.flow.showing.SHOWN_AT", 0.2)
    lines = [json.dumps(cell.plain()) + "\n" for cell in flow_cells()]
    (tmp_path / study.FILE).write_text("".join(lines))
    screen = io.StringIO()
    config = EvaluateConfig(out=tmp_path, tasks=(FLOW,), workers=1, resume=True)
    evaluate(config, Console(file=screen, width=160))
    assert "reservation" in screen.getvalue()
    page = (tmp_path / "report.html").read_text()
    assert '<a href="#flow">Flow</a>' in page
    assert "Flow: over event rule" in page
    assert "data:video/mp4;base64," in page
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert not (tmp_path / "comparison.md").exists()
    assert [json.loads(line) for line in (tmp_path / study.FILE).read_text().splitlines()] == [
        json.loads(line) for line in lines
    ]
