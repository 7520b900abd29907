"""How little the tables tell of the paper's step."""

import pytest

from surface_gym.paper.convergence import LAST_DIGITS, turned_end
from surface_gym.paper.integration import COARSE
from surface_gym.paper.sorting import ANGLE_TOLERANCE, POSITION_TOLERANCE
from surface_gym.paper.targets import load_targets


def test_5_ms_counts_as_the_tables_do(reproduction):
    at_5_ms = next(each for each in reproduction.by_step if each.integration == COARSE)

    for key, agreeing in at_5_ms.agreeing.items():
        assert agreeing == reproduction.table(key).agreeing(0)


def test_no_step_stands_out(reproduction):
    total = {
        round(1e3 * each.integration.dt, 1): sum(each.agreeing.values())
        for each in reproduction.by_step
    }

    assert sum(len(reproduction.table(k).cells) for k in ("table2", "table3", "table4")) == 93
    assert total[4.0] == total[5.0] == total[6.0] == max(total.values()) == 88
    assert total[3.0] == total[7.0] == 86
    assert min(total.values()) >= 82


def test_a_turn_of_all_axes_by_round_off_moves_the_ends_as_much_as_is_tolerated(reproduction):
    assert reproduction.last_digits.position > 1000.0 * POSITION_TOLERANCE
    assert reproduction.last_digits.position < reproduction.about_coarse.position + 5.0


@pytest.mark.parametrize("turn", [LAST_DIGITS[0], LAST_DIGITS[-1]])
def test_turned_by_round_off_either_way_all_of_table_2_agrees(turn):
    for run in load_targets().sorting_runs:
        x, y, theta = turned_end(run, turn, COARSE)
        # In whole millimetres, as the table has them.
        assert abs(round(x, 3) - run.x) <= POSITION_TOLERANCE + 1e-9
        assert abs(round(y, 3) - run.y) <= POSITION_TOLERANCE + 1e-9
        assert abs(theta - run.theta) <= ANGLE_TOLERANCE
