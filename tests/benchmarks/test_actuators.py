"""The benchmark of actuators: a fixed layout does not care whether axes wait, an agent does."""

import numpy as np

from benchmarks.actuators import LAB, WAITING, describe, find_methods, successes


def test_waiting_axes_cost_an_agent_success_and_a_fixed_layout_none() -> None:
    fixed, *_, agent = find_methods("slow")
    assert (fixed.name, agent.name) == ("fixed layout", "PPO, lab")
    same = [successes(fixed, each, 16) for each in (LAB, WAITING)]
    np.testing.assert_array_equal(*same)
    free, waiting = (successes(agent, each, 16) for each in (LAB, WAITING))
    assert free.shape == (len(agent.seeds), 16)
    assert free.mean() > waiting.mean() + 0.4
    assert describe(np.ones((1, 10), dtype=bool)).startswith("1.000 (0.")
