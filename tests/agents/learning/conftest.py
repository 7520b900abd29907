"""Environments in which learners are tried by day."""

from typing import Any

import pytest

from surface_gym.agents.learning import slopes
from surface_gym.config import EnvConfig
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact


@pytest.fixture(autouse=True)
def _exact_by_day(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Replace the lab of learners on slopes, whose kernel no other test needs, except at night."""
    if request.node.get_closest_marker("nightly"):
        return
    made = slopes.training_configs
    exact = {"sensors": Exact(), "actuators": Actuators(), "randomisation": Randomisation()}

    def exact_configs(config: Any) -> list[EnvConfig]:
        return [each.replace(**exact) for each in made(config)]

    monkeypatch.setattr(slopes, "training_configs", exact_configs)
