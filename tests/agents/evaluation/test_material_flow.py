"""The comparison of controllers on slopes: its bound, its measurements, its tables."""

import math
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

import surface_gym as sg
from surface_gym.agents.evaluation import material_flow as mf, material_flow_report as report
from surface_gym.agents.planning.receding_horizon import RecedingHorizon
from surface_gym.parcel import Parcel, assortment


class Small(RecedingHorizon):
    """A planner that tries little."""

    def __init__(self, rule, config) -> None:
        super().__init__(rule, config, candidates=2, horizon=10)


@pytest.fixture
def short(monkeypatch) -> None:
    monkeypatch.setattr(mf, "SECONDS", 10.0)
    monkeypatch.setattr(mf, "REPLICATIONS", 2)
    monkeypatch.setattr(mf, "PLANNED", 2)
    monkeypatch.setattr(mf, "RecedingHorizon", Small)


def test_the_narrowest_extent_is_the_least_over_all_angles() -> None:
    some = (*assortment(12, 3, load=0.0), Parcel(sg.Rectangle(0.4, 0.25)))
    for parcel in some:
        angles = np.linspace(0.0, math.pi, 20_001)
        ways = np.stack([np.cos(angles), np.sin(angles)])
        if len(parcel.body.edges):
            least = np.ptp(parcel.base.outline @ ways, axis=0).min()
        else:
            least = 2.0 * parcel.base.reach
        assert mf.narrowest(parcel) == pytest.approx(least, rel=2e-4)


def test_the_bound_is_the_packing_of_the_take_away() -> None:
    scenario = mf.scenarios(["singulate"])[0]
    config = scenario.config("exact", 900.0)
    box = Parcel(sg.Rectangle(0.4, 0.2))
    stream = replace(config.stream_task.stream, parcels=((box, 1.0),))
    assert mf.take_away_bound(config.replace(stream=stream)) == pytest.approx(3600.0 * 2.0 / 0.5)
    two = config.replace(stream=stream, exits="mouths")
    assert mf.take_away_bound(two) == pytest.approx(2.0 * 3600.0 * 2.0 / 0.5)


def test_scenarios_are_configured_for_each_preset() -> None:
    for scenario in mf.scenarios():
        for preset in mf.COMPARED:
            config = scenario.config(preset, 900.0)
            assert config.task_name == scenario.task
            sizes = {each.base for each, _ in config.stream_task.stream.parcels}
            assert (len(sizes) == mf.NEVER_SEEN) == (preset == "lab")
    assert {each.task for each in mf.scenarios(["merge"])} == {"merge"}


@pytest.mark.usefixtures("short")
class TestMeasurements:
    def test_an_order_is_asked_at_the_highest_rate_at_which_it_holds(self) -> None:
        scenario = next(each for each in mf.scenarios(["sequence"]) if each.window == 2)
        scenario = replace(scenario, rates=(1200.0, 600.0))
        found = mf.compute(scenario, mf.ORDER[0], "exact")
        assert found.right == 1.0
        assert found.rate > 600.0
        found = mf.compute(scenario, mf.ROLL_ON, "exact")
        assert found.right < mf.IN_ORDER

    def test_of_several_seeds_each_counts_alike(self) -> None:
        """A seed here says which rule it is."""
        roll, slots = mf.SINGLE[0], mf.SINGLE[2]
        both = mf.FlowMethod("both", lambda config, k: (roll, slots)[k].make(config, 0), (0, 1))
        scenario = mf.scenarios(["merge"])[0]
        one, other, found = (mf.compute(scenario, each, "exact") for each in (roll, slots, both))
        assert found.of_seeds == [one.rate, other.rate]
        assert found.rates == np.mean([one.rates, other.rates], axis=0).tolist()
        assert found.squeeze == max(one.squeeze, other.squeeze)

    def test_a_jam_in_which_parcels_tremble_is_seen(self, monkeypatch) -> None:
        monkeypatch.setattr(mf, "QUIET", 5.0)
        (scenario,) = (each for each in mf.scenarios(["merge"]) if each.name == "three lines")
        config = scenario.config("exact", scenario.rates[0])

        class Tremble(mf.RollOn):
            """Brake all, but let them roll for one control period in 25."""

            period = 0

            def _predict(self, batch, *_, **__):
                self.period += 1
                rolls, _ = super()._predict(batch)
                return rolls * (self.period % 25 == 0), None

        batch = mf.play(config, Tremble(config))
        assert (batch.outcome != mf.JAM).all()
        assert mf.find_jams(batch).all()
        rolling = mf.play(config, mf.ROLL_ON.make(config, 0))
        assert not mf.find_jams(rolling).any()

    def test_results_are_kept_and_written(self, tmp_path, monkeypatch) -> None:
        monkeypatch.setattr(mf, "SECONDS", 4.0)
        tasks = ["merge"]
        found = mf.compute_material_flow(tasks, 1, tmp_path)
        again = mf.compute_material_flow(tasks, 1, tmp_path)
        assert [repr(each) for each in again] == [repr(each) for each in found]  # nan is nan
        tables = report.write_material_flow(found, tmp_path, Console(quiet=True))
        assert [table.title for table in tables] == ["merge on a slope"]
        methods = {each.method for each in found}
        assert methods >= {each.name for each in mf.SINGLE}
        assert len(tables[0].rows) == len(found) == 2 * 3 * (len(methods) - 1) + 2
        for name in ("md", "csv", "json"):
            assert (tmp_path / f"material-flow.{name}").stat().st_size > 1000


def test_only_one_that_is_ahead_of_all_others_is_bold() -> None:
    def row(method: str, *rates: float) -> mf.MaterialFlowResult:
        return mf.MaterialFlowResult(
            "three lines", method, "exact", list(rates), [0.5], *[0.5] * 10, jams=0, bound=9000.0
        )

    apart = [row("one", 100.0, 200.0, 300.0), row("other", 90.0, 189.0, 291.0)]
    (table,) = report.material_flow_tables(apart)
    assert [cells[3].startswith("**") for cells in table.rows] == [True, False]
    near = [row("one", 100.0, 200.0, 300.0), row("other", 90.0, 260.0, 240.0)]
    (table,) = report.material_flow_tables(near)
    assert not any(cells[3].startswith("**") for cells in table.rows)
