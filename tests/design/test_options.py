"""A case as flags."""

import math
import re

import numpy as np
import pytest
import tyro

import surface_gym as sg
from surface_gym.design.options import CaseOptions, usable_cores
from surface_gym.design.purposes import Purpose, Slow, Sort, Stop, Turn


def asked(*flags: str) -> CaseOptions:
    return tyro.cli(CaseOptions, args=flags)


@pytest.mark.parametrize(
    ("flags", "purpose"),
    [
        ((), Sort(-1)),
        (("--side", "left"), Sort(1)),
        (("--purpose", "slow"), Slow(0.5)),
        (("--purpose", "slow", "--ratio", "0.7", "--tolerance", "0.1"), Slow(0.7, 0.1)),
        (("--purpose", "stop"), Stop()),
        (("--purpose", "stop", "--place", "0.4", "--tolerance", "0.1"), Stop(0.4, 0.1)),
        (("--purpose", "turn"), Turn()),
        (("--purpose", "turn", "--angle-deg", "-20"), Turn(math.radians(-20.0))),
    ],
)
def test_purposes(flags: tuple[str, ...], purpose: Purpose) -> None:
    assert asked("--parcel", "S", *flags).case().purpose == purpose


def test_parcels() -> None:
    assert asked("--parcel", "0.3x0.4").case().parcel.base == sg.Rectangle(0.3, 0.4)
    assert asked("--parcel", "B").case().parcel == sg.layouts.box("B")
    assert asked("--disc", "0.2", "--mass", "12").case().parcel == sg.Parcel(sg.Disc(0.2), 12.0)
    base = asked("--polygon", "0,0 0.3,0 0.2,0.25").case().parcel.base
    np.testing.assert_array_equal(base.outline, [[0.0, 0.0], [0.3, 0.0], [0.2, 0.25]])
    loaded = asked("--disc", "0.2", "--com-offset", "0.01", "0.02", "--inertia", "0.3").case()
    assert loaded.parcel.com_offset == (0.01, 0.02)
    assert loaded.parcel.inertia == 0.3


def test_the_surface_and_what_is_unknown() -> None:
    case = asked(
        "--parcel", "S", "--pitch", "0.1x0.12", "--tilt-deg", "5", "--friction", "0.1",
        "--unevenness", "0", "--com-spread", "0.2", "--heading-deg", "3", "--mu-max", "0.6",
    ).case()  # fmt: skip
    assert case.pitch == (0.1, 0.12)
    assert case.mu_max == 0.6
    assert case.tilt == pytest.approx(math.radians(5.0))
    assert case.unknown.friction == 0.1
    assert case.unknown.com_offset == 0.2
    assert case.unknown.heading == pytest.approx(math.radians(3.0))
    assert case.unknown.groups == ("friction", "load", "entry", "together")
    assert asked("--parcel", "S", "--pitch", "0.12").case().pitch == 0.12
    assert asked("--parcel", "S").case().draws == 100
    assert asked().workers == usable_cores() >= 1


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ((), "parcel must be one of --parcel, --disc and --polygon, got none"),
        (("--parcel", "S", "--disc", "0.2"), "got --parcel and --disc"),
        (("--parcel", "0.3"), "parcel must be LxW as 0.3x0.4, S or B, got '0.3'"),
        (("--parcel", "ax0.3"), "parcel must be made of numbers, got 'a' in it"),
        (("--polygon", "0,0 0.3"), "polygon must be 'X,Y X,Y X,Y', got '0,0 0.3'"),
        (("--parcel", "S", "--pitch", "1x2x3"), "pitch must be one number or two"),
        (("--parcel", "S", "--speed", "30"), "speed must be between 0 and 20, got 30.0"),
        (("--parcel", "S", "--ratio", "0.5"), "ratio must not be given to sort"),
        (("--parcel", "S", "--purpose", "slow", "--place", "1"), "place must not be given to slow"),
        (("--parcel", "S", "--purpose", "stop", "--angle-deg", "1"), "angle_deg must not be given"),
        (("--parcel", "S", "--tolerance", "1"), "tolerance must not be given to sort"),
        (("--parcel", "S", "--purpose", "stop", "--tolerance", "1"), "with --place only"),
        (("--parcel", "S", "--workers", "0"), "workers must be a whole number of at least 1"),
    ],
)
def test_an_error_names_the_flag(flags: tuple[str, ...], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        asked(*flags).case()
