"""The agent beside the scheduler where it never trained: scenarios, and the table of results."""

import numpy as np
import pytest
from rich.console import Console

import surface_gym as sg
from surface_gym.agents.evaluation import generalisation
from surface_gym.agents.evaluation.capacity import Measurement
from surface_gym.agents.evaluation.generalisation import (
    GeneralisationResult,
    Scenario,
    generalisation_numbers,
    generalisation_table,
)
from surface_gym.agents.scheduling.bounds import entrance_bound
from surface_gym.agents.scheduling.scheduler import Scheduler
from tests.agents.rules.runs import gated

SHORT = gated(duration=12.0)
SCENARIOS = generalisation.scenarios()


def measured(rights: list[int], touches: float = 0.0) -> Measurement:
    count = len(rights)
    return Measurement(3600.0, rights, rights, [touches] * count, [0.0] * count, 0, 36.0, 1.0)


def result(controller: str, rights: list[int], touches: float = 0.0) -> GeneralisationResult:
    return GeneralisationResult("late", controller, 4000.0, measured(rights, touches))


def test_names_tell_conditions_apart() -> None:
    assert len({each.name for each in SCENARIOS}) == len(SCENARIOS)


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda each: each.name)
def test_each_is_offered_what_the_entrance_takes(scenario) -> None:
    task = scenario.config.stream_task
    assert task.gate
    assert task.stream.arrivals.rate == pytest.approx(entrance_bound(scenario.config))


class TestTable:
    def test_rates_are_compared_in_pairs(self) -> None:
        rule = result("scheduler", [20, 22, 24])
        agents = [result(f"seed {k}", [21, 23, 25 - k], 1.0) for k in range(2)]
        table = generalisation_table([rule, *agents])
        ((name, one, _, two, touches, ratio, ahead, entrance),) = table.rows
        assert (name, one.split()[0], entrance) == ("late", "2200", "4000")
        # Each delivers one more in each replication, but for one.
        assert two.split()[0] == "2283"
        assert ratio.strip("*").split()[0] == "1.038"
        assert float(touches) == pytest.approx(1000.0 * np.mean([3 / 69, 3 / 68]), abs=0.05)
        assert ahead == "1 of 2"

    def test_only_what_is_apart_is_bold(self) -> None:
        rule = result("scheduler", [20, 22, 24])
        for rights, bold in (([21, 23, 25], True), ([23, 19, 24], False), ([18, 20, 22], True)):
            ((*_, ratio, _, _),) = generalisation_table([rule, result("seed 0", rights)]).rows
            assert ratio.startswith("**") is bold

    def test_numbers_are_listed(self) -> None:
        rows = generalisation_numbers([result("scheduler", [20, 22])])
        (rate,) = [row["value"] for row in rows if row["metric"] == "rate"]
        assert rate == pytest.approx(2100.0)


def test_results_are_kept_and_written(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(generalisation, "scenarios", lambda: [Scenario("short", SHORT)])
    monkeypatch.setattr(generalisation, "make_best_scheduler", lambda each: Scheduler(each.config))
    monkeypatch.setattr(
        generalisation.library,
        "load",
        lambda *given: Scheduler(given[2]),
    )
    rows = generalisation.compute_generalisation(1, tmp_path)
    assert rows[0].controller == generalisation.SCHEDULER
    assert len(rows) == 1 + len(generalisation.library.seeds(generalisation.LEARNED))
    monkeypatch.setattr(generalisation, "measure_stream", None)  # nothing is left to compute
    assert generalisation.compute_generalisation(1, tmp_path) == rows
    generalisation.write_generalisation(rows, tmp_path, Console(quiet=True))
    for suffix in (".md", ".csv", ".json"):
        assert (tmp_path / f"{generalisation.NAME}{suffix}").stat().st_size


def test_the_scheduler_is_the_one_that_delivers_more(monkeypatch) -> None:
    late = SHORT.replace(actuators=sg.Actuators(axis_speed=20.0, stuck_share=0.01))
    offered = [("slow", 3), ("prompt", 5)]
    monkeypatch.setattr(generalisation, "find_plain", lambda *_: offered.pop(0))
    assert generalisation.make_best_scheduler(Scenario("late", late)) == "prompt"
