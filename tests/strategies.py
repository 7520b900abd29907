"""Random surfaces, parcels and starts for the tests, drawn by Hypothesis."""

import math
from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st

import surface_gym as sg
from surface_gym.parcel import Base
from surface_gym.simulation import expect_tipping

ROWS, COLUMNS = 16, 20
MIDDLE = (1.0, 0.8)  # [m] of a surface of that size


@dataclass(frozen=True)
class Scene:
    """A surface, a parcel on it and how it starts."""

    surface: sg.Surface
    parcel: sg.Parcel
    pose: tuple[float, float, float]  # [m, m, rad]
    velocity: tuple[float, float, float]  # [m/s, m/s, rad/s]

    def run(
        self, duration: float = 0.4, dt: float = 0.005, method: str = "implicit"
    ) -> sg.Trajectory:
        with expect_tipping():
            return sg.simulate(
                self.surface, self.parcel, self.pose, self.velocity, duration, dt, method=method
            )

    def on(self, **changes: object) -> "Scene":
        """The same start on a surface with some fields changed."""
        return replace(self, surface=replace(self.surface, **changes))


def polygon_vertices(sides: int, radius: float, flatten: float, turn: float) -> np.ndarray:
    """Vertices of a convex polygon, anti-clockwise: a regular one, flattened and turned."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    x, y = radius * np.cos(angle), flatten * radius * np.sin(angle)
    cosine, sine = math.cos(turn), math.sin(turn)
    return np.column_stack([cosine * x - sine * y, sine * x + cosine * y])


lengths = st.floats(0.15, 0.5)
reaches = st.floats(0.25, 0.5)  # of a polygon, which then lies over an element wherever it is
angles = st.floats(-10.0, 10.0)
speeds = st.floats(-1.5, 1.5)
spins = st.floats(-3.0, 3.0)


@st.composite
def polygons(draw: st.DrawFn) -> sg.Polygon:
    """Three to seven sides, in either sense of rotation, off its frame's origin."""
    vertices = polygon_vertices(
        draw(st.integers(3, 7)), draw(reaches), draw(st.floats(0.5, 1.0)), draw(angles)
    )
    vertices += np.array([draw(st.floats(-0.1, 0.1)), draw(st.floats(-0.1, 0.1))])
    return sg.Polygon(vertices[::-1] if draw(st.booleans()) else vertices)


rectangles = st.builds(sg.Rectangle, lengths, lengths)
discs = st.builds(sg.Disc, st.floats(0.1, 0.3))
bases: st.SearchStrategy[Base] = st.one_of(rectangles, discs, polygons())


@st.composite
def parcels(draw: st.DrawFn) -> sg.Parcel:
    """Any base, its centre of mass off the centroid by up to 2 cm each way."""
    offset = st.floats(-0.02, 0.02)
    return sg.Parcel(
        draw(bases),
        mass=draw(st.floats(0.1, 50.0)),
        com_height=draw(st.floats(0.0, 0.2)),
        com_offset=(draw(offset), draw(offset)),
    )


@st.composite
def surfaces(draw: st.DrawFn, flat: bool = False) -> sg.Surface:
    """Every module's axis on its own; the rotors among supports or alone."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return sg.Surface(
        axis=rng.uniform(-np.pi, np.pi, size=(ROWS, COLUMNS)),
        rotor=rng.random((ROWS, COLUMNS)) < draw(st.sampled_from([0.0, 0.5, 0.8, 1.0])),
        stiffness=rng.uniform(0.5, 2.0, size=(ROWS, COLUMNS)) if draw(st.booleans()) else None,
        tilt=0.0 if flat else draw(st.sampled_from([0.0, math.radians(8.0), math.radians(-5.0)])),
        tilt_direction=0.0 if flat else draw(st.floats(-math.pi, math.pi)),
    )


@st.composite
def scenes(draw: st.DrawFn, flat: bool = False) -> Scene:
    """A parcel near the middle of a surface, sliding and spinning any way."""
    return Scene(
        surface=draw(surfaces(flat=flat)),
        parcel=draw(parcels()),
        pose=(
            MIDDLE[0] + draw(st.floats(-0.05, 0.05)),
            MIDDLE[1] + draw(st.floats(-0.05, 0.05)),
            draw(angles),
        ),
        velocity=(draw(speeds), draw(speeds), draw(spins)),
    )
