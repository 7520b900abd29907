"""The planner over modules: it plays halves as an environment does, and changes modules."""

import numpy as np

from benchmarks.module_planner import HALVES, MODULES, ModuleModel, ModulePlanner
from surface_gym.agents.planning.models import FIRST, TrueModel
from surface_gym.config import EnvConfig

CONFIG = EnvConfig("stop", actions="halves")
START = {"speed": 1.0, "parcel": "B", "position": 1.3}


def test_modules_obey_halves_as_they_do_in_the_environment() -> None:
    halves, modules = TrueModel(CONFIG, 1), ModuleModel(CONFIG, 1)
    for model in (halves, modules):
        model.begin(START, 0)
        assert model.uniform_action(0.5 * np.pi) == 15
    for action in (15, 15, 6, 15, 15, 9, 1, 7, 7, 15, 0):
        np.testing.assert_array_equal(
            halves.step(action).parcels.truth, modules.step(action).parcels.truth
        )
    assert abs(halves.parcels.truth[0, 2]) > 1e-3  # the halves have turned the parcel


def test_the_axes_under_the_parcel_move_it_and_others_do_not() -> None:
    model = ModulePlanner(CONFIG, MODULES).model
    model.begin(START, 0)
    for _ in range(10):
        model.step(15)
    model.rewind()
    under = model.under()
    rolling = model.spread_halves(np.array([15]), FIRST)[0]
    tried = np.tile(rolling, (len(rolling) + 1, 1))
    np.fill_diagonal(tried, 0)  # each module brakes alone; the last row has none
    moved = model.advance(np.zeros(len(tried), dtype=np.int64), tried).parcels.truth
    brakes = (moved[:-1] != moved[-1]).any(axis=1)
    assert brakes.sum() >= 9
    assert not (brakes & ~(under | model.under())).any()


def test_both_stop_within_a_hundredth_of_a_millimetre() -> None:
    for acts_by in (HALVES, MODULES):
        success, error = ModulePlanner(CONFIG, acts_by).play(START, 0)
        assert success == 1.0
        assert error < 1e-5
