"""Driven modules before a take-away: they lead each parcel as a rigid body would move."""

import math
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.evaluation.streams import play_stream
from surface_gym.agents.rules.velocities import COLUMNS, VelocityRule
from surface_gym.agents.scheduling.driven import AHEAD_ONLY, COLUMN_BELTS, TAKE_AWAY_KINDS
from surface_gym.config import EnvConfig
from surface_gym.flow.state import CORRECT, WRONG
from surface_gym.flow.take_away import bulk

ASIDE = sorted(set(TAKE_AWAY_KINDS) - set(AHEAD_ONLY))


def level(kind: str, **given: Any) -> EnvConfig:
    """A level surface whose modules obey at once."""
    modules = TAKE_AWAY_KINDS[kind](speed=2.0, acceleration=math.inf)
    return EnvConfig("singulate", modules=modules, tilt=0.0, **given)


@pytest.mark.parametrize("kind", ASIDE)
def test_parcels_at_any_angle_leave_aligned_through_a_mouth(kind):
    config = level(
        kind, exits="mouth", alignment=math.radians(10.0), stream=bulk(4000.0), duration=12.0
    )
    batch = play_stream(config, VelocityRule(config), 1)
    assert batch.streams.tally[0, WRONG] == 0
    assert batch.streams.tally[0, CORRECT] >= 7


def test_belts_of_modules_part_what_comes_side_by_side_and_belts_of_columns_do_not():
    share = []
    for kind in reversed(AHEAD_ONLY):
        config = level(kind, stream=bulk(14_000.0), duration=12.0)
        drives = {"drives": COLUMNS} if kind == COLUMN_BELTS else {}
        correct, wrong = play_stream(config, VelocityRule(config, **drives), 1).streams.tally[
            0, [CORRECT, WRONG]
        ]
        share.append(correct / (correct + wrong))
    assert share[0] > 0.95
    assert share[1] < 0.9


def test_modules_of_a_column_share_a_drive():
    config = level(COLUMN_BELTS)
    rule = VelocityRule(config, drives=COLUMNS)
    batch = play_stream(config.replace(duration=2.0), rule, 1)
    actions, _ = rule.predict(batch.observation)
    columns = actions.reshape(-1, config.action_kind.columns)
    assert (columns == columns[0]).all()
    assert len(np.unique(columns)) > 1  # some wait


def test_what_the_rule_cannot_lead_is_refused():
    with pytest.raises(ValueError, match=r"^modules must be"):
        VelocityRule(EnvConfig("singulate"))
    with pytest.raises(ValueError, match=r"^drives must be"):
        VelocityRule(level(COLUMN_BELTS), drives="rows")
    with pytest.raises(ValueError, match=r"^actions must be"):
        VelocityRule(level(COLUMN_BELTS, actions="parcels"))
