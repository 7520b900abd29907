import numpy as np

from surface_gym import layouts
from surface_gym.paper.occupancy import NONE, rotor_columns


def columns_by_base_functions(surface, size, pose):
    """Section 3.2's F_lambda <= 0, asked of every rotor of the surface."""
    x, y = np.meshgrid(surface.x, surface.y)
    dx, dy = x - pose[0], y - pose[1]
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    inside = layouts.box(size).base.functions(cosine * dx + sine * dy, cosine * dy - sine * dx)
    columns = np.nonzero((inside.max(axis=0) <= 0.0) & surface.rotor)[1]
    return (columns.min(), columns.max()) if len(columns) else (NONE, NONE)


def test_columns_are_those_of_the_rotors_inside_the_base():
    rng = np.random.default_rng(7)
    pose = rng.uniform([0.2, 0.5, -np.pi], [1.5, 1.5, np.pi], size=(300, 3))
    for size in ("S", "B"):
        surface = layouts.sorting(size)

        first, last = rotor_columns(surface, size, pose)

        expected = [columns_by_base_functions(surface, size, row) for row in pose]
        assert np.stack([first, last], axis=-1).tolist() == [list(map(int, e)) for e in expected]
        assert (last == NONE).any()
        assert (last != NONE).any()


def test_the_start_lies_wholly_on_the_lead_in():
    for size, lead_in in layouts.LEAD_IN.items():
        _, last = rotor_columns(layouts.sorting(size), size, np.array([layouts.start(size)]))

        assert last[0] < lead_in
