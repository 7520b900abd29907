"""The shortest line that carries a rate: what is predicted, and what is measured."""

import json
from dataclasses import replace

import pytest

from surface_gym.agents.scheduling import design
from surface_gym.agents.scheduling.design import (
    ARRANGED,
    COLUMNS,
    FOLLOWED,
    FOUR,
    MODULES,
    SIX,
    FlowCase,
    LineDesign,
    LineLayout,
    LineMeasurement,
    Search,
)
from surface_gym.agents.scheduling.flow_answer import FlowAnswer
from surface_gym.agents.scheduling.maneuvers import ColumnGroups
from surface_gym.flow.exits import Exit, Exits

CASE = FlowCase(8000.0, speed=1.0, longest=1.3)


@pytest.fixture(scope="module")
def found():
    """The line of columns that carries it, which runs for less long, and its search."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(design, "REPLICATIONS", 8)
        patch.setattr(design, "SECONDS", 18.0)
        search = Search(CASE, COLUMNS)
        best = search.find(len(FOUR))
        assert best is not None
        layout, row = best
        return search, layout, replace(row, stuck=search.run_stuck(layout, len(FOUR)))


def test_the_line_carries_the_rate_and_one_a_column_shorter_does_not(found):
    search, layout, row = found
    assert row.carries
    assert row.length == pytest.approx(0.1 * layout.columns)
    assert row.actuators == layout.columns - 5
    assert row.predicted >= CASE.rate
    shorter = search.scheduler(layout._replace(columns=layout.columns - 1), len(FOUR))
    assert shorter is None or search.predict(layout, shorter.library) < CASE.rate


def test_what_is_measured_is_what_was_predicted(found):
    _, _, row = found
    assert row.run.rate == pytest.approx(row.predicted, rel=0.04)
    assert row.run.share_correct == pytest.approx(1.0)
    assert row.run.touches_per_1000 == row.run.jams == 0
    assert sum(row.run.share_at) == pytest.approx(1.0)
    assert row.run.turns_per_parcel > 1.0


def test_stuck_modules_cost_deliveries(found):
    _, _, row = found
    assert row.remaining[0] == 1.0
    assert row.remaining[-1] < 0.95
    assert len(row.remaining) == len(design.STUCK)


def test_more_actuators_and_more_orientations_carry_no_less():
    columns, width = 12, 7
    kinds = {
        ARRANGED: ColumnGroups(width, 1, True), FOLLOWED: ColumnGroups(width, 1),
        COLUMNS: ColumnGroups(), MODULES: None,
    }  # fmt: skip
    rates = []
    for hardware, groups in kinds.items():
        search = Search(CASE, hardware)
        four, six = (search.rate(LineLayout(columns, groups), len(each)) for each in (FOUR, SIX))
        assert six >= four > 0.0
        rates.append(four)
    assert rates == sorted(rates)


def test_the_curve_rises(found):
    lengths, rates = zip(*found[2].curve, strict=True)
    assert list(lengths) == sorted(set(lengths))
    assert list(rates) == sorted(rates)
    assert lengths[-1] == CASE.longest


def test_exits_must_lie_along_the_line():
    beside = Exits((Exit("left", 1, 1.05, 2.5), Exit("straight", 0)))
    assert FlowCase(1000.0, exits=beside, longest=3.0).columns == range(11, 31)


def test_a_long_parcel_has_a_long_lead_in():
    assert FlowCase(1000.0, (("B", 1.0),)).lead_in == 5
    assert CASE.config(9).line.lead_in == 5


def answer(row: LineDesign, rate: float) -> FlowAnswer:
    return FlowAnswer(replace(CASE, rate=rate), (row,))


def test_an_answer_in_words_tables_and_json(found):
    row = found[2]
    said = answer(row, CASE.rate)
    assert "the shortest line is 1" in said.sentence
    assert f"({row.actuators} actuators, 4 orientations)" in said.sentence
    for table in said.tables():
        assert table.rows
        assert all(len(each) == len(table.header) for each in table.rows)
    assert json.loads(json.dumps(said.as_json()))["lines"][0]["actuators"] == row.actuators
    able, _ = said.draw().axes
    assert able.get_xlabel() == "line [m]"
    none = answer(replace(row, carries=False), 12_000.0).sentence
    assert none.startswith("No line of up to 1.3 m carries 12000 parcels an hour: most, ")


def test_a_driven_line_stands_beside_idle_ones():
    run = LineMeasurement(8100.0, 50.0, 1.0, 0.0, 0, 40.0, 900.0, (1.0, 0.0, 0.0, 0.0))
    row = LineDesign(COLUMNS, FOUR, True, 1.2, 1, 7, 8200.0, run, ((1.2, 8200.0),))
    driven = replace(
        row, hardware="steered rollers, 10 deg", motors=(1, 1), actuators=9,
        run=replace(run, energy=3.0),
    )  # fmt: skip
    said = FlowAnswer(replace(CASE, driven=True, turn_energy=0.5), (row,), (driven,))
    assert (row.energy(0.5), driven.energy(0.5)) == (5.0, 8.0)  # four rows turn together
    saved = "saves 11 motors and 3.0 J a parcel, which is 6.7 W"
    assert said.sentence.endswith(saved)
    table = next(each for each in said.tables() if each.name == "flow-driven")
    assert [each[3] for each in table.rows] == [7, 18]
    assert [each["hardware"] for each in said.as_json()["lines"]] == [COLUMNS, driven.hardware]
    short = replace(CASE, driven=True).config(9, by_parcel=False, module=CASE.make_module("pop-up"))
    assert short.module_kind.motors == (2, 0)


def test_a_data_sheet_tells_energy_and_life(found):
    row = found[2]
    case = replace(CASE, turn_energy=0.5, turn_life=1e6)
    tables = {table.name: table for table in FlowAnswer(case, (row,)).tables()}
    assert "flow-wear" not in {table.name for table in answer(row, CASE.rate).tables()}
    ((*_, turns, energy, hours, parcels),) = tables["flow-wear"].rows
    assert turns == pytest.approx(row.run.turns_per_parcel / 4)  # four rows turn together
    assert energy == pytest.approx(0.5 * turns)
    assert hours == pytest.approx(1e6 / row.run.turns_per_hour)
    # A life's turns of all actuators, over the turns for a parcel.
    assert parcels == pytest.approx(1e6 * row.actuators / turns, rel=0.2)
    with pytest.raises(ValueError, match=r"^turn_energy must"):
        replace(CASE, turn_energy=-1.0)
