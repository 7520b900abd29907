"""Bases: Section 3.2's functions, and what the physics asks of an area, against sampling."""

import dataclasses
import math
import re
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import ArrayLike

import surface_gym as sg
from surface_gym.parcel import Base, Disc, Polygon, Rectangle, assortment
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera, Exact, Presence
from surface_gym.tasks import Sort
from tests.strategies import bases, polygon_vertices, polygons

BOX = sg.Rectangle(0.25, 0.25)
TRIANGLE = sg.Polygon([(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])
MANY = assortment(400, seed=3)
PENTAGRAM = polygon_vertices(5, 0.3, 1.0, 0.0)[[0, 2, 4, 1, 3]]


def samples(base: Base, count: int = 400) -> np.ndarray:
    """(2, points) of a fine grid over the area."""
    x, y = base.centroid
    side = np.linspace(-base.reach, base.reach, count)
    points = np.stack(np.meshgrid(x + side, y + side)).reshape(2, -1)
    return points[:, base.functions(*points).max(axis=0) <= 0.0]


def assert_same_area(one: Base, other: Base) -> None:
    assert one.centroid == pytest.approx(other.centroid, abs=1e-12)
    assert one.gyration == pytest.approx(other.gyration)
    assert one.reach == pytest.approx(other.reach)
    points = np.meshgrid(np.linspace(-0.5, 0.5, 50), np.linspace(-0.5, 0.5, 50))
    functions = (base.functions(*points).max(axis=0) for base in (one, other))
    np.testing.assert_allclose(*functions, atol=1e-12)


class TestAreas:
    @given(base=bases)
    def test_centroid_and_gyration_are_those_of_the_area(self, base):
        points = samples(base)
        assert points.shape[1] > 10_000
        np.testing.assert_allclose(points.mean(axis=1), base.centroid, atol=0.005 * base.reach)
        assert points.var(axis=1).sum() == pytest.approx(base.gyration, rel=0.01)

    @given(base=bases)
    def test_reach_is_the_distance_to_the_farthest_point_of_the_outline(self, base):
        offset = base.outline - base.centroid
        assert np.hypot(*offset.T).max() == pytest.approx(base.reach, rel=1e-9)

    @given(base=bases)
    def test_the_outline_runs_anti_clockwise_along_the_zero_of_the_functions(self, base):
        largest = base.functions(*base.outline.T).max(axis=0)
        np.testing.assert_allclose(largest, 0.0, atol=1e-12)
        x, y = base.outline.T
        assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0.0

    @given(base=bases, share=st.floats(0.0, 0.999), beyond=st.floats(1.001, 3.0))
    def test_functions_tell_inside_from_outside(self, base, share, beyond):
        offset = base.outline - base.centroid
        inside, outside = (np.array(base.centroid) + scale * offset for scale in (share, beyond))
        assert (base.functions(*inside.T).max(axis=0) <= 0.0).all()
        assert (base.functions(*outside.T).max(axis=0) > 0.0).all()

    @pytest.mark.parametrize(
        ("base", "gyration", "reach"),
        [
            (sg.Rectangle(0.3, 0.4), 0.25 / 12.0, 0.25),
            (sg.Disc(0.2), 0.02, 0.2),
            # A right isosceles triangle of legs a: a^2 / 9 about its centroid.
            (sg.Polygon([(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)]), 0.01, 0.1 * math.sqrt(5.0)),
        ],
    )
    def test_known_areas(self, base, gyration, reach):
        assert base.gyration == pytest.approx(gyration)
        assert base.reach == pytest.approx(reach)


class TestPolygons:
    def test_a_box_drawn_as_a_polygon_is_the_same_box(self):
        box = sg.Rectangle(0.3, 0.4)
        assert_same_area(sg.Polygon(box.outline), box)

    @given(polygon=polygons())
    def test_the_sense_of_rotation_does_not_matter(self, polygon):
        assert_same_area(sg.Polygon(polygon.vertices[::-1]), polygon)

    @given(turn=st.floats(-4.0, 4.0), sides=st.integers(3, 8))
    def test_a_vertex_within_a_side_is_allowed(self, turn, sides):
        corners = polygon_vertices(sides, 0.3, 0.8, turn)
        middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
        more = sg.Polygon(np.stack([corners, middles], axis=1).reshape(-1, 2))
        assert more.gyration == pytest.approx(sg.Polygon(corners).gyration)

    def test_a_polygon_keeps_a_read_only_copy(self):
        vertices = polygon_vertices(4, 0.2, 1.0, 0.0)
        polygon = sg.Polygon(vertices)
        vertices[:] = 0.0
        assert polygon.reach == pytest.approx(0.2)
        with pytest.raises(ValueError, match="read-only"):
            polygon.vertices[0] = 0.0

    @pytest.mark.parametrize(
        ("vertices", "message"),
        [
            ([(0, 0), (1, 0)], "be at least 3, got 2"),
            ([(0, 0), (1, 0), (1, 0), (0, 1)], "differ from their neighbours"),
            ([(0, 0), (1, 0), (0.2, 0.2), (0, 1)], "form a convex polygon, got "),
            ([(0, 0), (1, 1), (1, 0), (0, 1)], "form a convex polygon, got "),
            (PENTAGRAM, "form a convex polygon, got "),
            ([(0, 0), (1, 0), (2, 0), (1, 0)], "form a convex polygon, got "),
            ([(0, 0), (1e-5, 0), (0, 1e-5)], "enclose at least 1e-08 m.2, got 5e-11 m.2"),
            ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], r"have the shape \(any, 2\)"),
        ],
    )
    def test_polygons_that_are_not_allowed(self, vertices, message):
        with pytest.raises(ValueError, match=f"^vertices must {message}"):
            sg.Polygon(vertices)


@dataclass(frozen=True)
class Tile:
    """A base of your own: a rectangle, by what the protocol asks for and nothing else."""

    length: float
    width: float

    centroid = (0.0, 0.0)

    @property
    def gyration(self) -> float:
        return (self.length**2 + self.width**2) / 12.0

    @property
    def reach(self) -> float:
        return math.hypot(self.length, self.width) / 2.0

    @property
    def edges(self) -> np.ndarray:
        half_length, half_width = self.length / 2.0, self.width / 2.0
        return np.array(
            [[1, 0, half_length], [0, 1, half_width], [-1, 0, half_length], [0, -1, half_width]],
            dtype=float,
        )

    @property
    def outline(self) -> np.ndarray:
        return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [self.length / 2, self.width / 2]

    def functions(self, x: ArrayLike, y: ArrayLike) -> np.ndarray:
        x, y = np.asarray(x), np.asarray(y)
        return np.stack([nx * x + ny * y - distance for nx, ny, distance in self.edges])

    def scaled(self, factor: float) -> "Tile":
        return Tile(factor * self.length, factor * self.width)


class TestABaseOfOnesOwn:
    def test_moves_as_the_same_shape_does(self):
        start = ((0.5, 1.0, 0.2), (1.2, 0.1, 0.4), 0.6)
        own, box = (
            sg.simulate(sg.layouts.sorting("B"), sg.Parcel(kind(0.4, 0.25)), *start).pose
            for kind in (Tile, sg.Rectangle)
        )
        np.testing.assert_allclose(own, box, rtol=0, atol=1e-9)

    @pytest.mark.parametrize("sensor", [Exact(), Camera(), Presence()], ids=type)
    def test_runs_and_varies_in_an_environment(self, sensor):
        env = sg.SmartSurfaceEnv(
            Sort(parcels=(sg.Parcel(Tile(0.3, 0.2)),)),
            actions="quadrants",
            sensors=sensor,
            randomisation=Randomisation(size=0.1, com_offset=0.2),
            actuators=Actuators(axis_speed=8.0),
            render_mode="rgb_array",
        )
        for seed in range(3):
            observation, _ = env.reset(seed=seed)
            assert observation in env.observation_space
            env.step(env.action_space.sample())
        assert env.render() is not None

    def test_what_it_lacks_is_named(self):
        bare = type("Bare", (), {"centroid": (0.0, 0.0)})
        with pytest.raises(ValueError, match="must have gyration, reach, edges, outline"):
            sg.Parcel(bare())
        loose = type("Loose", (Tile,), {"__hash__": None})
        with pytest.raises(ValueError, match="base must be hashable"):
            sg.Parcel(loose(0.3, 0.2))

    @pytest.mark.parametrize(
        ("name", "values"),
        [
            ("gyration", (-1.0, 1e9)), ("reach", (math.nan, 1e9)), ("edges", ([1.0],)),
            ("outline", (None,)),
        ],
    )  # fmt: skip
    def test_what_is_wrong_is_named(self, name, values):
        for value in values:
            wrong = type("Wrong", (Tile,), {name: value})
            with pytest.raises(ValueError, match=rf"base\.{name} must"):
                sg.Parcel(wrong(0.3, 0.2))


class TestParcels:
    def test_defaults_are_table_1_and_a_given_inertia_is_kept(self):
        parcel = sg.Parcel(BOX)
        assert (parcel.mass, parcel.com_height) == (10.0, 0.1)
        assert parcel.moment_of_inertia == pytest.approx(10.0 * (0.25**2 + 0.25**2) / 12.0)
        parcel = sg.Parcel(BOX, mass=5.48, inertia=0.057)
        assert parcel.moment_of_inertia == 0.057
        assert parcel.body.gyration == pytest.approx(0.057 / 5.48)

    def test_the_centre_of_mass_is_offset_from_the_centroid(self):
        assert sg.Parcel(TRIANGLE).centre_of_mass == pytest.approx((0.1, 0.1))
        shifted = sg.Parcel(TRIANGLE, com_offset=(0.02, -0.03))
        assert shifted.centre_of_mass == pytest.approx((0.12, 0.07))

    def test_parcels_are_frozen_and_equal_where_their_fields_are(self):
        with pytest.raises(dataclasses.FrozenInstanceError):
            sg.Parcel(BOX).mass = 1.0
        assert sg.Parcel(BOX) == sg.Parcel(sg.Rectangle(0.25, 0.25))
        assert sg.Parcel(BOX) != sg.Parcel(BOX, mass=9.0)
        assert len({sg.Parcel(BOX), sg.Parcel(sg.Rectangle(0.25, 0.25))}) == 1

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"base": None}, "base must be a Rectangle, a Disc or a Polygon, got None"),
            ({"base": sg.Rectangle}, "base must be a Rectangle, a Disc or a Polygon"),
            ({"com_offset": (0.2, 0.0)}, "com_offset must keep the centre of mass over the base"),
            ({"com_offset": 0.0}, r"com_offset must have the shape \(2\)"),
        ],
    )
    def test_what_is_not_allowed_is_refused(self, changes, message):
        with pytest.raises(ValueError, match=f"^{message}"):
            sg.Parcel(**{"base": BOX, **changes})


class TestAssortment:
    def test_the_same_seed_gives_the_same_parcels_whose_shapes_come_in_turn(self):
        for again, parcel in zip(assortment(12, seed=3), MANY[:12], strict=True):
            np.testing.assert_array_equal(again.base.outline, parcel.base.outline)
            assert again.com_offset == parcel.com_offset
        assert assortment(1, seed=4) != MANY[:1]
        for place, parcel in enumerate(MANY):
            assert isinstance(parcel.base, (Rectangle, Rectangle, Disc, Polygon)[place % 4])
        assert all(parcel.base.length == parcel.base.width for parcel in MANY[::4])
        assert any(parcel.base.length != parcel.base.width for parcel in MANY[1::4])

    @pytest.mark.parametrize("sizes", [(0.2, 0.45), (0.15, 0.5), (0.3, 0.3)])
    def test_sizes_are_within_their_bounds(self, sizes):
        extents = np.array(
            [np.ptp(parcel.base.outline, axis=0) for parcel in assortment(200, 0, sizes, load=0.01)]
        )
        least = min(sizes[0], 0.75 * sizes[0])  # a polygon's, of the least circle
        assert extents.min() >= least - 1e-9
        assert extents.max() <= sizes[1] + 1e-9

    def test_lengths_are_uniform(self):
        """A square's mean and spread are those of the uniform law, within four standard errors."""
        lengths = np.array(
            [np.ptp(parcel.base.outline[:, 0]) for parcel in assortment(1600, 1)[::4]]
        )
        spread = 0.25 / np.sqrt(12.0)
        assert lengths.mean() == pytest.approx(0.325, abs=4.0 * spread / np.sqrt(len(lengths)))
        assert lengths.std() == pytest.approx(spread, rel=0.1)

    def test_loads_are_uniform_in_a_disc_over_the_base(self):
        offsets = np.array([parcel.com_offset for parcel in MANY])
        distance = np.hypot(*offsets.T)
        assert distance.max() <= 0.03
        # In a disc, the square of the distance is uniform.
        assert (distance**2).mean() == pytest.approx(0.5 * 0.03**2, rel=0.15)
        assert np.abs(offsets.mean(axis=0)).max() < 4.0 * 0.015 / np.sqrt(len(MANY))
        for parcel in MANY:
            assert parcel.base.functions(*parcel.centre_of_mass).max() <= 0.0
        assert {parcel.com_offset for parcel in assortment(8, 0, load=0.0)} == {(0.0, 0.0)}

    def test_polygons_are_convex_and_hold_their_centroid(self):
        for parcel in MANY[3::4]:
            corners = parcel.base.outline
            edges = np.roll(corners, -1, axis=0) - corners
            after = np.roll(edges, -1, axis=0)
            assert (edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0] > 0.0).all()
            assert parcel.base.functions(*parcel.base.centroid).max() < 0.0

    @pytest.mark.parametrize(
        ("arguments", "expected"),
        [
            ({"count": 0}, "count must be a whole number of at least 1, got 0"),
            ({"seed": -1}, "seed must be a whole number of at least 0, got -1"),
            ({"sizes": (0.4, 0.2)}, "sizes must rise within (0.0001, 1000.0) m, got (0.4, 0.2)"),
            ({"sizes": 0.2}, "sizes must have the shape (2)"),
            ({"load": -0.01}, "load must be at least 0, got -0.01"),
            ({"load": 50.0}, "load must lie over most bases, got 50 m"),
        ],
    )
    def test_what_is_not_allowed(self, arguments, expected):
        with pytest.raises(ValueError, match=f"^{re.escape(expected)}"):
            assortment(**{"count": 4, "seed": 0, **arguments})
