"""Hidden surfaces are identified from their logs, and what logs cannot tell is said."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.machine import identification
from surface_gym.machine.estimate import PARAMETERS
from surface_gym.machine.identification import measure_noise
from surface_gym.machine.log import MachineLog
from tests.machine.recorded import HIDDEN, SURFACE, recorded

KNOWN = {name: getattr(HIDDEN, name) for name in PARAMETERS if name != "dead_time"}


def known(*free: str) -> dict[str, float]:
    """All of the hidden surface but what is to be found."""
    return {name: value for name, value in KNOWN.items() if name not in free}


def test_a_surface_is_found_within_the_intervals() -> None:
    free = ("mu_max", "mu_min", "quarter_turn", "latency")
    found = sg.identify([recorded()], free=free, known=known(*free))
    assert found.inseparable == found.unknown == ()
    assert found.is_explained
    for name in free:
        low, high = found.intervals[name]
        middle, half = found.values[name], 0.5 * (high - low)
        assert abs(middle - KNOWN[name]) < 1.5 * half, name
    assert found.values["mu_max"] == pytest.approx(HIDDEN.mu_max, abs=0.01)
    assert found.values["mu_min"] == pytest.approx(HIDDEN.mu_min, abs=0.003)
    assert found.values["quarter_turn"] == pytest.approx(HIDDEN.quarter_turn, abs=0.005)
    assert found.values["latency"] == pytest.approx(HIDDEN.latency, abs=0.004)


def test_runs_that_coast_do_not_tell_friction_along_axes_nor_tilt() -> None:
    free = ("mu_max", "mu_min", "tilt", "quarter_turn")
    log = recorded(is_excited=False)
    found = sg.identify([log], free=free, known=known(*free))
    assert "quarter_turn" in found.unknown
    assert not found.is_determined("quarter_turn")
    assert any({"mu_min", "tilt"} <= set(group) for group in found.inseparable) or (
        not found.is_determined("mu_min") and not found.is_determined("tilt")
    )
    for name in free:
        low, high = found.intervals[name]
        assert low <= KNOWN[name] <= high, name  # never confident and wrong


@pytest.mark.parametrize(
    ("free", "acknowledged", "more", "sure"),
    [
        (("latency", "dead_time"), True, {}, False),
        (("latency", "dead_time"), False, {}, False),
        (("latency",), False, {}, False),
        (("dead_time",), False, {}, False),
        (("latency",), False, {"dead_time": 0.0}, True),
        (("latency",), True, {}, True),
    ],
)
def test_delays_of_pictures_and_of_axes_only_have_one_effect(
    free: tuple[str, ...], acknowledged: bool, more: dict[str, float], sure: bool
) -> None:
    log = recorded(runs=5, seconds=0.6)
    log = replace(log, runs=tuple(replace(run, acknowledged=acknowledged) for run in log.runs))
    given = {name: value for name, value in known(*free).items() if name != "latency"}
    found = sg.identify([log], free=free, known={**given, **more})
    assert tuple(found.values) == free
    for name in free:
        assert found.is_determined(name) is sure
    assert (("latency", "dead_time") in found.inseparable) is not sure
    if sure:
        assert found.values["latency"] == pytest.approx(HIDDEN.latency, abs=0.01)


def test_an_uneven_surface_is_not_explained() -> None:
    """Its elements' stiffness has a spread that the model lacks."""
    log = recorded(stiffness=0.35)
    free = ("mu_max", "mu_min")
    found = sg.identify([log], free=free, known=known(*free))
    assert not found.is_explained
    assert "does not explain" in next(found.warnings())


def test_noise_is_found_from_pictures_alone() -> None:
    position, angle = measure_noise(recorded().runs)
    assert position == pytest.approx(0.002, rel=0.15)
    assert angle == pytest.approx(math.radians(0.5), rel=0.15)


def empty() -> MachineLog:
    return MachineLog(SURFACE, (), {}, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"free": ()}, "free must name at least one"),
        ({"free": ("mass",)}, "free must be"),
        ({"known": {"mu_max": 0.5}}, "known must not be among free"),
        ({"known": {"mass": 1.0}}, "known must be"),
        ({"known": {"tilt": math.nan}}, "tilt must be"),
        ({"noise": (0.0, 0.01)}, "noise must be"),
        ({"dt": 0.0}, "dt must be"),
        ({"logs": ()}, "at least one log"),
        ({"logs": (empty(),)}, "usable runs"),
    ],
)
def test_what_is_not_allowed_is_refused(change: dict, message: str) -> None:
    given = {"logs": (recorded(runs=5, seconds=0.6),), "free": ("mu_max",), **change}
    with pytest.raises(ValueError, match=message):
        sg.identify(given.pop("logs"), **given)


def test_logs_are_of_one_surface_and_one_tilt() -> None:
    log = recorded(runs=5, seconds=0.6)
    other = replace(log, surface=replace(SURFACE, quarter_turn=0.1))
    with pytest.raises(ValueError, match="one surface"):
        sg.identify([log, other], free=["mu_max"])
    tilted = replace(log, runs=(*log.runs[1:], replace(log.runs[0], tilt=0.1)))
    with pytest.raises(ValueError, match="tilt must be the same"):
        sg.identify([tilted], free=["tilt"])


def test_runs_without_acknowledgement_are_left_out_among_others() -> None:
    log = recorded(runs=5, seconds=0.6)
    mixed = replace(log, runs=(replace(log.runs[0], acknowledged=False), *log.runs[1:]))
    found = sg.identify([mixed], free=["mu_max"], known=known("mu_max"))
    assert len(found.misfits) == 4
    assert sum(found.unused.values()) == 1


def test_of_more_runs_than_suffice_some_are_left_out(monkeypatch) -> None:
    monkeypatch.setattr(identification, "MAX_RUNS", 4)
    found = sg.identify([recorded(runs=5, seconds=0.6)], free=["mu_max"], known=known("mu_max"))
    assert len(found.misfits) == 4
    assert found.unused == {"4 parcels suffice": 1}


def test_the_same_log_gives_the_same_estimate_and_progress_is_determined() -> None:
    notes: list[str] = []
    given = {"free": ["mu_max"], "known": known("mu_max")}
    log = recorded(runs=5, seconds=0.6)
    found = sg.identify([log], **given, on_progress=notes.append)
    assert sg.identify([log], **given) == found
    assert notes[0] == "a first search"
    assert notes[-1] == "intervals"
    assert np.all([isinstance(each, str) for each in notes])
