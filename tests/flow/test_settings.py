"""The arguments of a flow, checked once for both environments."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import lines
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow.exits import Exit, Exits, chutes, flow_line, sides
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import FEATURES
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera
from surface_gym.vector_env import SmartSurfaceVectorEnv
from tests.flow.flows import SHORT, trace

# Each under the name that its error tells, and the argument where that has another.
BAD: dict[str, list[Any]] = {
    "stream": [None, 1200.0],
    "destinations of stream": [Stream(destinations={"north": 1.0})],
    "exit of stream": [trace((0.0, "north"))],
    "parcels of stream": [
        Stream(parcels=(sg.Parcel(sg.Rectangle(*size)),))
        for size in ((0.3, 0.08), (0.3, 2.1), (6.7, 0.3))
    ],
    "exits": ["doors", (), ("left",), None],
    "actions": ["halves", None],
    "duration": [0.0, 0.03],
    "max_parcels": [0, 257, 2.0, True],
    "line": ["line", SHORT.rotor],
    "tilt": [math.nan],
    "tilt_direction": [90.0, None],
    "stuck of actuators": [Actuators(stuck=((99, 0),))],
    "restitution": [-0.1, 1.1, None],
    "gate": [1, None],
    "queue": [0, 2, 2.0, True],
    "ahead": [-0.1, True],
    "entry_offset": [0.1],
    "entry_turn": [0.1],
    "time_limit": [100],
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_named(name: str) -> None:
    named, _, argument = name.partition(" of ")
    for value in BAD[name]:
        with pytest.raises(ValueError, match=named):
            EnvConfig("flow", **{argument or named: value})


@pytest.mark.parametrize("env_type", [SmartSurfaceEnv, SmartSurfaceVectorEnv])
def test_both_environments_check_them(env_type: Any) -> None:
    for name in ("exits", "duration", "tilt", "gate"):
        with pytest.raises(ValueError, match=name):
            env_type(task="flow", **{name: BAD[name][0]})
    with pytest.raises(ValueError, match="render_mode"):
        env_type(task="flow", render_mode="ansi")


TINY = Stream(parcels=(sg.Parcel(sg.Rectangle(0.1, 0.1)),))  # a pitch long
# What is allowed by itself, and not with something else.
TOGETHER: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "gate": ({"gate": True}, {"orientations": "any"}),  # it counts choices
    "queue must be a whole number of at most 64": ({"gate": True, "queue": 64}, {"queue": 65}),
    "queue must be 1 without a gate": ({"gate": True, "queue": 2}, {"gate": False}),
    # A line as wide as its parcel has other rotors for another one.
    "line must have the same rotors": (
        {"line": lines.Line()}, {"stream": Stream(parcels=("S", "B"))},
    ),
    # None can fall between rotors.
    "parcels must be at least a pitch long": (
        {"stream": TINY}, {"randomisation": Randomisation(size=0.01)},
    ),
    # A sensor must find its noise in a control period.
    "sensors must use at most": (
        {"sensors": Camera(frame_rate=200.0), "control_period": 0.31}, {"control_period": 0.32},
    ),
    # Stuck modules are modules of the line.
    "stuck": ({"actuators": Actuators(stuck=((9, 26),))}, {"line": SHORT}),
}  # fmt: skip


@pytest.mark.parametrize("message", TOGETHER)
def test_what_is_allowed_by_itself_but_not_with_something_else(message: str) -> None:
    alone, beside = TOGETHER[message]
    settings = EnvConfig("flow", **alone)
    with pytest.raises(ValueError, match=message):
        EnvConfig("flow", **{**alone, **beside})
    if "stream" in beside:
        with pytest.raises(ValueError, match=message):
            settings.stream_task.check_stream(Stream(parcels=("B",)), settings)


class TestWhatFollows:
    def test_presets_are_as_long_as_the_line(self) -> None:
        assert EnvConfig("flow").exits == chutes(6.0)
        short = EnvConfig("flow", line=SHORT, exits="sides")
        assert [exit.last for exit in short.exits] == pytest.approx([2.0, 2.0, math.inf])
        own = (Exit("a", 1), Exit("b", -1))
        for given in (own, Exits(own)):
            assert EnvConfig("flow", exits=given).exits == Exits(own)
        assert sides(6.0).names == EnvConfig("flow", exits="sides").exits.names

    def test_of_a_line_that_begins_elsewhere(self) -> None:
        pattern = lines.Pattern(rotor=flow_line(2.0).rotor, lead_in=5, origin=(1.05, 3.05))
        settings = EnvConfig("flow", line=pattern)
        assert settings.entry_x == pytest.approx(1.0)
        assert settings.rotors_end == pytest.approx(3.0)

    def test_bounds_are_those_of_the_features(self) -> None:
        for gate in (False, True):
            space = EnvConfig("flow", max_parcels=3, gate=gate).observation_space()
            assert space.dtype == np.float32
            assert space.shape == (3 + gate, len(FEATURES))
            for column, feature in enumerate(FEATURES):
                assert (space.low[:, column] == np.float32(feature.low)).all()
                assert (space.high[:, column] == np.float32(feature.high)).all()
        assert len({feature.name for feature in FEATURES}) == len(FEATURES)

    @pytest.mark.parametrize(
        ("period", "steps", "periods"), [(0.04, 8, 50), (0.005, 1, 400), (0.03, 6, 67)]
    )
    def test_timing(self, period: float, steps: int, periods: int) -> None:
        settings = EnvConfig("flow", control_period=period, duration=2.0)
        assert settings.timing.steps == steps
        assert settings.periods == periods
        assert EnvConfig("flow", control_period=period, gate=True).action_kind.gates == steps + 1

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("length", 0.5), ("length", -1.0), ("rotor_rows", 3), ("rotor_rows", 14),
            ("rotor_rows", 0), ("lead_in", -1), ("lead_in", 1.0),
        ],
    )  # fmt: skip
    def test_bad_lines_are_named(self, name: str, value: Any) -> None:
        with pytest.raises(ValueError, match=name):
            flow_line(**{name: value})
