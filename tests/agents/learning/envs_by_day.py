"""Environments in which learners on slopes are tried by day."""

from typing import Any

import pytest

from surface_gym.agents.learning import slopes
from surface_gym.config import EnvConfig
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact


def learn_with_exact_sensors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the lab, whose kernel no other test needs, and which the night tries."""
    made = slopes.training_configs

    def exact_configs(config: Any) -> list[EnvConfig]:
        exact = {"sensors": Exact(), "actuators": Actuators(), "randomisation": Randomisation()}
        return [each.replace(**exact) for each in made(config)]

    monkeypatch.setattr(slopes, "training_configs", exact_configs)
