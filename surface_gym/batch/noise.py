"""Noise drawn ahead for the sensor of a parcel."""

import numpy as np

from surface_gym.lanes.memory import NOISE_ROWS, Lanes


def draw_noise(lanes: Lanes, row: int, generator: np.random.Generator) -> None:
    """Three standard normals and a uniform a row of noise, for the parcel in a row of `lanes`."""
    noise = lanes.noise[row]
    noise[:, :3] = generator.standard_normal((NOISE_ROWS, 3))
    noise[:, 3] = generator.random(NOISE_ROWS)
    lanes.noise_row[row] = 0
