"""The protocol: cells, their starts, and what a policy may choose."""

import pytest

from surface_gym.agents.benchmark import protocol
from surface_gym.agents.benchmark.protocol import CELLS, TASKS, TestCell, read_protocol


def test_every_cell_has_a_digest_and_seeds_of_its_own() -> None:
    digests = read_protocol()["digests"]
    assert list(digests) == list(TASKS)
    assert all(list(cells) == list(CELLS) for cells in digests.values())
    cells = protocol.list_cells(TASKS)
    starts = {(cell.task, CELLS[cell.cell].preset): cell for cell in cells}
    assert len({cell.digest for cell in cells}) == len(starts)  # cells of a preset share starts
    seeds = {cell.seed + k for cell in starts.values() for k in range(protocol.EPISODES)}
    assert len(seeds) == protocol.EPISODES * len(starts)


@pytest.mark.parametrize("cell", ["0 ms", "lab"])
def test_starts_are_those_of_the_protocol_whatever_a_policy_chooses(cell: str) -> None:
    test = TestCell("sort", cell)
    config = test.config({"actions": "halves", "control_period": 0.08})
    assert test.compute_digest(config) == test.digest
    assert test.periods(config) == 50  # 4 s, as with the default period


def test_another_start_has_another_digest() -> None:
    first, second = TestCell("sort", "0 ms"), TestCell("sort", "lab")
    config = first.config({"actions": "halves"})
    assert first.compute_digest(config, 4) != second.compute_digest(config, 4)


def test_slower_axes_are_set_by_the_cell() -> None:
    speeds = [TestCell("stop", cell).config({}).actuators.axis_speed for cell in CELLS]
    assert speeds[0] == float("inf")
    assert speeds[1] == pytest.approx(2.0 * speeds[2])


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"zone": (4, 5)}, "env_kwargs must be one of 'actions', .* got 'zone'"),
        ({"actions": "thirds"}, "actions must be .* got 'thirds'"),
        ({"gate": True}, "unexpected keyword argument 'gate'"),
    ],
)
def test_what_a_policy_must_not_choose_is_named(chosen: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TestCell("sort", "0 ms").config(chosen)
