"""The cells of the comparison on flows: all of them, kept, and computed once."""

import json
import pickle
from pathlib import Path
from typing import Any

import pytest

from agents.flow import capacity, study
from agents.flow.capacity import Measured
from agents.flow.cases import CURVE, LOADS, Case, cases
from agents.flow.contenders import (
    ARRANGED,
    EACH,
    EVENT,
    FIXED,
    RESERVATION,
    TURNED,
    FlowContender,
    contenders,
)
from agents.flow.study import (
    FILE,
    SEARCHED,
    FlowCell,
    compute_flow,
    compute_flows,
    flow_cell,
    flow_jobs,
)

BY_NAME = {contender.name: contender for contender in contenders()}


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """One stream, one load, two replications."""
    monkeypatch.setattr(capacity, "REPLICATIONS", 2)
    monkeypatch.setattr(study, "cases", lambda condition: [Case("S", 2.0, condition)])
    monkeypatch.setattr(study, "LOADS", (0.25,))


def test_the_ceiling_is_parcels_end_to_end() -> None:
    assert Case("S", 1.5).ceiling == pytest.approx(3600.0 * 1.5 / 0.3)
    assert Case("S and B", 1.0).ceiling == pytest.approx(3600.0 / 0.4)
    assert (LOADS[0], LOADS[-1], len(LOADS)) == (0.1, 1.0, 8)


def test_everyone_acts_in_settings_of_their_own() -> None:
    assert list(BY_NAME)[:6] == [FIXED, ARRANGED, TURNED, EVENT, EACH, RESERVATION]
    for contender in contenders():
        for condition in contender.conditions:
            settings = contender.settings(Case("S and B", 1.0, condition), 2000.0)
            assert (settings.actions, settings.gate) == (contender.actions, contender.gate)
            assert settings.exits.names == ("left", "right", "straight")
            varies = settings.randomisation.friction
            assert varies == (0.2 if condition == "camera" else 0.0)


@pytest.mark.parametrize("contender", contenders(), ids=lambda contender: contender.name)
def test_everyone_can_be_made(contender: FlowContender) -> None:
    settings = contender.settings(Case("S", 1.5), 2000.0)
    controller = contender.make(settings)
    assert controller is not None
    space = settings.observation_space()
    action, _ = controller.predict(0.0 * space.low)
    assert settings.action_space().contains(action)


def test_who_cannot_sort_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.flow.contenders.best_zone", lambda *_: None)
    cell = compute_flow(BY_NAME[ARRANGED], Case("S", 1.5), SEARCHED)
    assert (cell.can, cell.capacity, cell.eased) == (False, None, None)


def test_every_cell_is_asked_for_once() -> None:
    jobs = flow_jobs(contenders())
    searched = [key for key in jobs if key[-1] == SEARCHED]
    count = sum(len(contender.conditions) for contender in contenders())
    assert len(searched) == 6 * count
    assert len(jobs) - len(searched) == len(LOADS) * len(contenders())
    assert {key[3:5] for key in jobs if key[-1] != SEARCHED} == {(CURVE.mix, CURVE.speed)}
    assert {(mix, speed) for _, _, _, mix, speed, _ in searched} == {
        (case.mix, case.speed) for case in cases()
    }


def test_a_cell_comes_back_from_a_file() -> None:
    measured = Measured(900.0, [1, 2], [1, 3], [0.0, 0.5], [0.1, 0.0], 0, 22.0)
    for cell in (
        FlowCell("one", "exact", "S", 1.5, SEARCHED, True, measured, measured),
        FlowCell("one", "exact", "S", 1.5, 0.5, True, None, measured),
        FlowCell("one", "camera", "S", 1.0, SEARCHED, False, None, None),
    ):
        assert flow_cell(**json.loads(json.dumps(cell.plain()))) == cell


@pytest.mark.usefixtures("small")
class TestComputing:
    def test_who_holds_a_rate_is_eased(self) -> None:
        cell = compute_flow(BY_NAME[RESERVATION], Case("S", 2.0), SEARCHED)
        assert cell.capacity is not None
        assert cell.eased is not None
        assert cell.eased.offered == pytest.approx(0.8 * cell.capacity.rate)
        assert cell.eased.share_right == 1.0

    def test_who_holds_none_is_measured_at_the_least(self) -> None:
        case = Case("S", 2.0)
        cell = compute_flow(BY_NAME[FIXED], case, SEARCHED)
        assert (cell.can, cell.capacity) == (True, None)
        assert cell.eased is not None
        assert cell.eased.offered == pytest.approx(case.ceiling / 16.0)

    def test_what_is_there_is_kept(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        some = [BY_NAME[FIXED], BY_NAME[TURNED]]
        first = compute_flows(some[:1], 1, tmp_path)
        with (tmp_path / FILE).open("a") as file:
            file.write('{"contender": "zone')  # a line broken off
        seen: list[tuple[int, int]] = []
        both = compute_flows(some, 1, tmp_path, lambda done, total, _: seen.append((done, total)))
        assert both[:2] == first
        assert seen == [(done, 5) for done in (3, 4, 5)]
        assert [(cell.contender, cell.condition, cell.load) for cell in both[2:]] == [
            (TURNED, "exact", SEARCHED), (TURNED, "exact", 0.25), (TURNED, "camera", SEARCHED),
        ]  # fmt: skip

        def nothing(*_: Any) -> None:
            raise AssertionError("nothing is left to compute")

        monkeypatch.setattr(study, "measure", nothing)
        assert compute_flows(some, 1, tmp_path) == both


def test_jobs_can_be_sent_to_other_processes() -> None:
    jobs = flow_jobs(contenders())
    assert pickle.loads(pickle.dumps(jobs)).keys() == jobs.keys()
