"""Estimates make lines and presets, and come back from their files."""

import json
import math
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.lines import Line
from surface_gym.machine.estimate import write_report
from tests.machine.recorded import ESTIMATE


def test_an_estimate_comes_back(tmp_path) -> None:
    ESTIMATE.save(tmp_path / "estimate.json")
    assert sg.Estimate.load(tmp_path / "estimate.json") == ESTIMATE


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "estimates"},
        {"version": 2},
        {"values": {"mu_max": None}},
        {"intervals": {}},
        {"misfit": "large"},
        {"correlations": [[1.0]]},
        {"more": 1},
    ],
)
def test_another_file_is_refused(tmp_path, change: dict) -> None:
    file = tmp_path / "estimate.json"
    ESTIMATE.save(file)
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(ValueError, match="must be an estimate"):
        sg.Estimate.load(file)
    file.write_text("[1")
    with pytest.raises(ValueError, match="must be an estimate"):
        sg.Estimate.load(file)


def test_a_line_has_the_friction_that_is_determined() -> None:
    line = ESTIMATE.line(Line())
    assert line.mu_max == 0.42
    assert line.mu_min == Line().mu_min
    assert line.columns == Line().columns


def test_a_preset_makes_environments() -> None:
    preset = ESTIMATE.preset("machine 7")
    assert preset.actuators.axis_speed == pytest.approx(0.5 * math.pi / 0.08)
    assert preset.sensors.latency == pytest.approx(0.04)
    assert preset.sensors.position_noise == 0.002
    assert preset.randomisation.friction == pytest.approx(0.01 / 0.42)
    env = gym.make(
        "SmartSurface/Sort-v0", actions="halves", preset=preset, line=ESTIMATE.line(Line())
    )
    env.reset(seed=0)
    env.step(env.action_space.sample())


def test_an_environment_is_put_on_the_identified_surface() -> None:
    """Parcels, entries and stuck modules stay, and friction that the logs do not tell."""
    lab = EnvConfig("slow", preset="lab", actions="quadrants")
    found = ESTIMATE.adapt(lab)
    assert (found.chosen_line.mu_max, found.chosen_line.mu_min) == (0.42, Line().mu_min)
    assert found.sensors.latency == pytest.approx(0.04)
    assert (found.sensors.position_noise, found.sensors.angle_noise) == ESTIMATE.noise
    assert found.actuators == replace(lab.actuators, axis_speed=0.5 * math.pi / 0.08)
    assert found.randomisation == replace(
        lab.randomisation, friction=ESTIMATE.preset().randomisation.friction
    )
    assert (found.task, found.actions) == (lab.task, lab.actions)
    assert isinstance(ESTIMATE.adapt(EnvConfig("sort")).sensors, sg.sensors.Exact)


def test_an_estimate_of_nothing_leaves_an_environment_its_preset() -> None:
    lab = EnvConfig("stop", preset="lab")
    noise = lab.sensors.position_noise, lab.sensors.angle_noise
    nothing = replace(ESTIMATE, values={}, intervals={}, noise=noise)
    assert nothing.adapt(lab) == lab.replace(line=lab.chosen_line)


def test_a_preset_of_nothing_determined_is_exact_about_axes() -> None:
    nothing = replace(ESTIMATE, values={}, intervals={}, delay=0.0)
    preset = nothing.preset()
    assert preset.actuators == sg.Actuators()
    assert preset.randomisation == sg.Randomisation()


def test_warnings_say_what_is_not_determined() -> None:
    said = " ".join(ESTIMATE.warnings())
    for part in ("does not explain", "mu_min and tilt", "do not tell mu_min", "not used: 1"):
        assert part in said


def test_the_report_shows_all_of_it(tmp_path: Path) -> None:
    write_report(ESTIMATE, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    for part in (
        "0.42",
        "0.41 to 0.43",
        "not determined",
        "does not explain",
        "run 2: 2.40",
        "<svg",
    ):
        assert part in page
    assert "<script" not in page
