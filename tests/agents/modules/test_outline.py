"""What an observation tells of a base, against the base itself."""

import numpy as np
import pytest

import surface_gym as sg
from agents.modules.outline import Outline, outline_by_clearance, outline_shown
from agents.sight import line_sight
from surface_gym.layouts import rows_under
from surface_gym.lines import Pattern
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.randomisation import Randomisation
from surface_gym.settings import Settings
from tests.environments import PITCH

SQUARES = tuple(Rectangle(side, side) for side in (0.15, 0.25, 0.4, 0.45, 0.55))
RECTANGLES = (
    Rectangle(0.4, 0.25), Rectangle(0.37, 0.27), Rectangle(0.25, 0.4), Rectangle(0.35, 0.2),
    Rectangle(0.22, 0.34), Rectangle(0.2, 0.39), Rectangle(0.45, 0.399), Rectangle(0.3, 0.55),
)  # fmt: skip
DISCS = tuple(Disc(radius) for radius in (0.1, 0.15, 0.199, 0.2, 0.225))
HEXAGON = Polygon(0.2 * np.array([(np.cos(k), np.sin(k)) for k in np.pi / 3.0 * np.arange(6)]))


def seen_turned(
    bases: tuple[Base, ...], observe: tuple[str, ...] = ()
) -> tuple[Settings, np.ndarray, list[Base]]:
    """Settings, observations (lanes, features) and the base of each lane, turned at random."""
    each = [base for base in bases for _ in range(20)]
    env = sg.SmartSurfaceVectorEnv(
        len(each), observe=observe, randomisation=Randomisation(lateral=0.05, heading=0.5)
    )
    starts = [{"speed": 2.0, "parcel": Parcel(base), "side": 1} for base in each]
    seen, info = env.reset(seed=0, options=starts)
    assert np.ptp(info["pose"][:, 2]) > 1.0
    return env.settings, seen, each


def by_clearance(settings: Settings, seen: np.ndarray) -> Outline:
    clearance = 0.2 * seen[:, 7].astype(np.float64)
    return outline_by_clearance(line_sight(settings, seen), clearance, settings.chosen_plant)


@pytest.mark.parametrize(
    "bases", [SQUARES, RECTANGLES, DISCS], ids=["squares", "rectangles", "discs"]
)
def test_the_clearance_tells_width_and_rows(bases: tuple[Base, ...]) -> None:
    settings, seen, each = seen_turned(bases)
    outline = by_clearance(settings, seen)
    half = np.array([np.ptp(base.outline, axis=0) / 2.0 for base in each]).T
    np.testing.assert_allclose(outline.half, half, atol=2e-6)
    assert outline.rows.tolist() == [rows_under(2.0 * width, PITCH) for width in half[1]]
    assert not outline.roundness.any()


def test_a_square_is_as_wide_as_long_to_the_last_bit() -> None:
    settings, seen, _ = seen_turned(SQUARES)
    see, outline = line_sight(settings, seen), by_clearance(settings, seen)
    np.testing.assert_array_equal(outline.half, [see.half_length, see.half_length])
    np.testing.assert_array_equal(outline.reach(see.theta), see.reach)


@pytest.mark.parametrize(
    ("bases", "roundness"),
    [(SQUARES + RECTANGLES, 0.0), (DISCS, 1.0), ((HEXAGON,), 0.25 / (1.0 - np.pi / 4.0))],
)
def test_what_is_shown_is_known(bases: tuple[Base, ...], roundness: float) -> None:
    settings, seen, each = seen_turned(bases, ("parcel",))
    length, width, fill = seen[:, -3:].astype(np.float64).T
    outline = outline_shown(length, width, fill, settings.chosen_plant)
    half = np.array([np.ptp(base.outline, axis=0) / 2.0 for base in each]).T
    np.testing.assert_allclose(outline.half, half, atol=2e-6)
    np.testing.assert_allclose(outline.roundness, min(roundness, 1.0), atol=1e-5)
    assert outline.rows.tolist() == [rows_under(2.0 * width, PITCH) for width in half[1]]


@pytest.mark.parametrize(("base", "roundness"), [(Rectangle(0.4, 0.25), 0.0), (Disc(0.17), 1.0)])
def test_reach_and_outside_are_the_bases(base: Base, roundness: float) -> None:
    rng = np.random.default_rng(0)
    theta = rng.uniform(-np.pi, np.pi, 200)
    half = np.ptp(base.outline, axis=0)[:, np.newaxis] / 2.0 + np.zeros(200)
    outline = Outline(half, np.full(200, roundness), np.full(200, 2.0))
    turned = np.stack([np.cos(theta), -np.sin(theta)])
    np.testing.assert_allclose(outline.reach(theta), (base.outline @ turned).max(axis=0), atol=2e-3)
    place = rng.uniform(-0.3, 0.3, (2, 200))
    beyond = base.functions(*place).max(axis=0)
    np.testing.assert_allclose(outline.outside(place), beyond, atol=1e-6)
    np.testing.assert_array_equal(outline.of(np.array([3, 3])).half, half[:, [3, 3]])


def test_rows_of_a_pattern_are_its_own() -> None:
    rotor = np.zeros((20, 30), dtype=bool)
    rotor[7:13] = True
    half = np.zeros(3)  # as long and as wide as is between the boxes
    outline = outline_shown(half, half, half + 1.0, Pattern(rotor, lead_in=4))
    assert outline.rows.tolist() == [6.0, 6.0, 6.0]
