"""The layout that leads everything to one side."""

import pytest

from agents.flow.fixed import FixedLayout
from surface_gym.flow.batch import FlowBatch
from tests.agents.flow.lines import counts, gated, line
from tests.flow.flows import trace


def test_all_axes_are_alike_whoever_comes() -> None:
    settings = line(actions="modules")
    layout = FixedLayout(settings)
    seen = FlowBatch(settings, 3).observation
    actions, state = layout.predict(seen)
    assert state is None
    assert actions.shape == (3, settings.flow_actions.size)
    assert (actions == 2).all()  # -45 deg, which leads to y > 0
    assert layout.predict(seen[0])[0].tolist() == actions[0].tolist()


def test_it_sorts_to_the_left_alone() -> None:
    for name, right, wrong in (("left", 1, 0), ("right", 0, 1), ("straight", 0, 1)):
        settings = line(trace((0.0, name)), actions="modules", duration=4.0)
        assert counts(FixedLayout(settings), settings, lanes=1) == {
            "right": right, "wrong": wrong, "touches": 0,
        }  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (line(), "actions must be one of 'modules', got 'parcels'"),
        (gated(actions="modules"), "gate must be False for a layout, .* got True"),
        (line(actions="modules", orientations=(0.0, 1.0)), "orientations must hold"),
    ],
)
def test_what_it_cannot_act_in_is_refused(settings: object, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        FixedLayout(settings)  # type: ignore[arg-type]
