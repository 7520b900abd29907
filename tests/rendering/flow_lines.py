"""A line of 60 columns and 6 of supports, with what its pictures are measured by."""

import math
from dataclasses import replace

import numpy as np

import surface_gym as sg
from surface_gym.rendering import ExitMark, FlowParcel, FlowScene, draw_flow
from surface_gym.rendering.palette import PLATE_EDGE

SMALL = sg.Rectangle(0.25, 0.25).outline
LONG = sg.Rectangle(0.45, 0.25).outline
EXITS = (
    ExitMark("A", 1, 1.0, 2.0),
    ExitMark("B", -1, 3.0, 4.0),
    ExitMark("on", 0, 6.0, 6.6),
)
HIGHEST, LOWEST = 1.7, 0.3  # [m] what is drawn of the surface: 0.5 m beside the rotor rows


def empty_line():
    """Nothing moves on it."""
    rotor = np.zeros((20, 66), bool)
    rotor[8:12, :60] = True
    return FlowScene(
        axis=np.full((20, 66), math.pi / 2), rotor=rotor, exits=EXITS, delivered=(0, 0, 0)
    )


def busy_line():
    """Four parcels, of which two touch, and all that a scene may tell."""
    trail = np.stack([np.linspace(2.4, 3.0, 30), np.full(30, 1.05)], axis=-1)
    parcels = (
        FlowParcel(SMALL, (0.4, 1.0, 0.1), 0),
        FlowParcel(LONG, (1.5, 1.3, 0.7), 0, sensed_pose=(1.52, 1.28, 0.75)),
        FlowParcel(LONG, (3.0, 1.05, -0.2), 2, trail=trail, label="7"),
        FlowParcel(SMALL, (3.37, 1.0, 0.0), 1),
    )
    return replace(
        empty_line(),
        parcels=parcels,
        touching=((2, 3),),
        delivered=(3, 1, 12),
        missorted=2,
        waiting=4,
        title="Sort a stream",
        readings=(("time", "12.3 s"), ("parcels an hour", "3 600")),
    )


def pixel_finder():
    """From [m] to fractions of a pixel (column, row), by the plate's border."""
    border = (draw_flow(replace(empty_line(), exits=(), delivered=())) == PLATE_EDGE).all(axis=2)
    rows = np.flatnonzero(border.mean(axis=1) > 0.7)
    columns = np.flatnonzero(border.mean(axis=0) > 0.4)
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1

    def pixel(x, y):
        column = left + (right - left) * x / 6.6
        return column, top + (bottom - top) * (HIGHEST - y) / (HIGHEST - LOWEST)

    return pixel


def at(picture, place):
    """The colour at fractions of a pixel (column, row)."""
    return tuple(picture[int(place[1]), int(place[0])].tolist())


def changed(picture, other):
    """(left, right, top, bottom) [px] of where two pictures differ."""
    rows, columns = np.nonzero((picture != other).any(axis=2))
    return columns.min(), columns.max() + 1, rows.min(), rows.max() + 1
