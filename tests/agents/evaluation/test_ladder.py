"""Rungs of the ladder: zones as long as serves best, hardware, and schedulers of lines."""

from types import SimpleNamespace
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.agents.evaluation import ladder
from surface_gym.agents.evaluation.method import all_methods
from surface_gym.agents.evaluation.results import Sample, make_rows
from surface_gym.agents.evaluation.scenario import Extent, ScenarioJob
from surface_gym.agents.evaluation.stream_scenario import StreamScenario
from surface_gym.agents.scheduling.maneuvers import ColumnGroups
from tests.agents.rules.runs import gated

CASE = StreamScenario("flow", "exact", Extent(replications=2), "S, 2 m/s, sides")
BY_NAME = {each.name: each for each in all_methods("flow")}


def measured(name: str) -> Sample:
    return Sample(make_rows(ScenarioJob(CASE, BY_NAME[name], 0)()))


def test_zones_are_as_long_as_lets_most_parcels_in(monkeypatch) -> None:
    known = {4: 3000.0, 5: 3500.0, 6: 3400.0, 7: 3300.0}
    tried = []

    def library(_: object, groups: Any, **__: float) -> Any:
        tried.append(groups.columns)
        right = np.array([groups.columns in known])
        return SimpleNamespace(correct=right, gaps=np.zeros(1), signature=right, groups=groups)

    monkeypatch.setattr(ladder, "make_library", library)
    monkeypatch.setattr(ladder, "predict_rate", lambda made, *_: known[made.groups.columns])
    # The best does not do without touches.
    monkeypatch.setattr(
        ladder, "make_scheduler", lambda _, groups: groups if groups.columns != 5 else None
    )
    method = BY_NAME[ladder.ARRANGED]
    assert method.controller(CASE.config(method), 0) == ColumnGroups(6, 1, exclusive=True)
    assert tried == [4, 5, 6, 7]


def test_a_method_that_cannot_sort_has_no_capacity(monkeypatch) -> None:
    monkeypatch.setattr(ladder, "make_scheduler", lambda *_: None)
    found = measured(ladder.MODULES)
    assert (found.constant("actuators"), found.is_sustained) == (0, False)
    assert np.isnan(found.constant("best"))


def test_a_rung_is_measured_with_its_hardware() -> None:
    found = measured(ladder.ARRANGED)
    assert (found.constant("actuators"), found.constant("modules")) == (
        1,
        4 * found.constant("columns"),
    )
    assert found.constant("offered") == found.constant("bound")  # all that the entrance takes
    assert 0.9 < found.throughput / found.constant("best") < 1.1
    assert 0.3 < found.turns / found.constant("modules") < 2.0  # the same exit may come twice


def test_the_scheduler_is_the_one_that_delivers_more(monkeypatch) -> None:
    late = gated(duration=12.0).replace(actuators=sg.Actuators(axis_speed=20.0, stuck_share=0.01))
    offered = [("slow", 3), ("prompt", 5)]
    monkeypatch.setattr(ladder, "find_plain", lambda *_: offered.pop(0))
    monkeypatch.setattr(ladder, "make_model_library", lambda *_: None)
    assert ladder.make_best_scheduler(late, 0) == "prompt"
