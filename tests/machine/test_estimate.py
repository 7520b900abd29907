"""Estimates make lines and presets, and come back from their files."""

import json
import math
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import pytest

import surface_gym as sg
from surface_gym.lines import Line
from surface_gym.machine.estimate import write_report

ESTIMATE = sg.Estimate(
    values={"mu_max": 0.42, "mu_min": 0.013, "quarter_turn": 0.08, "latency": 0.01},
    intervals={
        "mu_max": (0.41, 0.43), "mu_min": (-math.inf, math.inf), "quarter_turn": (0.07, 0.09),
        "latency": (0.009, 0.011),
    },
    correlations=((1.0, 0.0, 0.0, 0.0),) * 4,
    correlated=("mu_max", "mu_min", "quarter_turn", "latency"),
    inseparable=(("mu_min", "tilt"),),
    unknown=("mu_min",),
    misfit=1.7,
    is_explained=False,
    misfits=(1.0, 2.4),
    frames=120,
    noise=(0.002, 0.01),
    delay=0.03,
    unused={"parcel is still on the surface": 1},
)  # fmt: skip


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
    env = gym.make("SmartSurface/Stop-v0", preset=preset, line=ESTIMATE.line(Line()))
    env.reset(seed=0)
    env.step(env.action_space.sample())


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
