"""Hits of sides with restitution and friction, against an impact that is integrated here."""

import itertools
import math
from typing import NamedTuple

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.parcel import Base
from surface_gym.physics import types as ph
from surface_gym.physics.rollout import distance_between
from surface_gym.physics.types import Array
from tests.strategies import polygon_vertices
from tests.worlds import Meeting, ice

STEPS = 2000  # of the normal impulse that would stop a hit without friction


class Hits(NamedTuple):
    """Hits of two parcels at one point, where nothing rubs below; an entry each."""

    closing: Array  # [m/s] before, positive
    slip: Array  # [m/s] before
    parting: Array  # [m/s] after
    left: Array  # [m/s] slip after
    by_normal: Array  # [1/kg] speed along the normal by an impulse along it
    coupling: Array  # [1/kg] along the side by one along the normal, and the other way round
    by_side: Array  # [1/kg] along the side by one along it
    restitution: Array  # [-]
    friction: Array  # [-]
    gain: Array  # [-] of energy


def draw_parcel(rng: np.random.Generator) -> sg.Parcel:
    bases: list[Base] = [
        sg.Disc(rng.uniform(0.1, 0.3)),
        sg.Rectangle(*rng.uniform(0.15, 0.5, 2)),
        sg.Polygon(polygon_vertices(rng.integers(3, 8), 0.3, rng.uniform(0.5, 1.0), 0.0)),
    ]
    com_x, com_y = rng.uniform(-0.02, 0.02, 2)
    mass = math.exp(rng.uniform(-1.0, 2.0))
    return sg.Parcel(bases[rng.integers(3)], mass, com_offset=(com_x, com_y))


def hit(rng: np.random.Generator, restitution: float) -> tuple[float, ...] | None:
    """One hit; None where they pass each other, or a second point is about to touch."""
    poses = np.array([(1.0, 1.5, 0.0), (3.0, 1.5, 0.0)])
    poses += rng.uniform(-1.0, 1.0, (2, 3)) * [0.0, 0.1, math.pi]
    velocities = rng.normal(size=(2, 3)) * [0.3, 0.3, 2.0]
    velocities[:, 0] += rng.uniform(0.3, 2.0) * np.array([1.0, -1.0])
    friction = rng.uniform(0.0, 0.9)
    who = [draw_parcel(rng), draw_parcel(rng)]
    meeting = Meeting(ice(), who, poses, velocities, restitution, friction)
    while (gap := distance_between(meeting.world, 0, 1)) > 2e-5 and meeting.place[1, 0] > 1.0:
        meeting.place[1, 0] -= 0.9 * gap
    before, energy = meeting.velocity.copy(), meeting.energy
    if not meeting.step(1e-4):
        return None
    points = meeting.scratch.point[meeting.scratch.point[:, ph.NORMAL_STIFFNESS] > 0.0]
    point, *others = sorted(points, key=lambda each: float(each[ph.CLOSING]))
    nx, ny, x, y, other_x, other_y, *_ = point
    along = np.array([(nx, ny), (-ny, nx)])
    turning = along @ np.array([(-y, -other_y), (x, other_x)])
    # (2, 6) speeds along normal and side by the velocities of both
    speeds = np.hstack([-along, -turning[:, :1], along, turning[:, 1:]])
    mobility = (
        speeds / np.column_stack([meeting.masses] * 2 + [meeting.inertias]).ravel() @ speeds.T
    )
    closing, slip = speeds @ before.ravel()
    parting, left = speeds @ meeting.velocity.ravel()
    if closing > -0.1 or (others and others[0][ph.CLOSING] < 20.0):
        return None
    gain = meeting.energy / energy - 1.0
    across = mobility[0, 0], mobility[0, 1], mobility[1, 1]
    return -closing, slip, parting, left, *across, restitution, friction, gain


def draw_hits(count: int, least: float, most: float) -> Hits:
    """Hits at restitutions between two."""
    rng = np.random.default_rng(count)
    drawn = (hit(rng, rng.uniform(least, most)) for _ in itertools.count())
    rows = itertools.islice((row for row in drawn if row is not None), count)
    return Hits(*np.array(list(rows)).T)


def integrate(hits: Hits) -> tuple[Array, Array]:
    """Speed of parting and slip after hits, in small steps of the normal impulse (Darboux, Keller).

    In each step friction takes what stops the slip, or all that Coulomb allows.
    """
    normal, slip = -hits.closing, hits.slip.copy()
    step = hits.closing / hits.by_normal / STEPS
    given, end = np.zeros_like(step), np.full_like(step, np.inf)
    while (given < end).any():
        wanted = -(slip / step + hits.coupling) / hits.by_side
        ratio = np.clip(wanted, -hits.friction, hits.friction)
        opening = hits.by_normal + hits.coupling * ratio
        pressing = np.isinf(end)
        # The last step of compression, and of restitution, is as long as is left.
        to_end = np.where(opening > 0.0, -normal / np.where(opening > 0.0, opening, 1.0), np.inf)
        share = np.minimum(step, np.where(pressing, to_end, end - given))
        normal += share * opening
        slip += share * (hits.coupling + hits.by_side * ratio)
        given += share
        stopped = pressing & (share == to_end)
        end[stopped] = (1.0 + hits.restitution[stopped]) * given[stopped]
    return normal, slip


def turns_back(hits: Hits) -> Array:
    """Whether the normal impulse drives slip on against the friction."""
    return np.abs(hits.coupling) > hits.friction * hits.by_side


@pytest.mark.parametrize(("least", "most"), [(0.0, 0.0), (1e-6, 1.0)])
def test_a_hit_ends_as_the_integrated_impact_and_gains_no_energy(least: float, most: float) -> None:
    hits = draw_hits(1000, least, most)
    parting, slip = integrate(hits)
    np.testing.assert_allclose(hits.left, slip, atol=1e-3)
    np.testing.assert_allclose(hits.parting, parting, atol=1e-3)
    assert hits.gain.max() <= 1e-12
    reversed_slip = hits.left * hits.slip < -1e-9
    assert (turns_back(hits) | ~reversed_slip).all()
    assert reversed_slip.sum() > 5


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_disc_that_slides_past_another_stops_sliding_and_spins_the_same(
    restitution: float,
) -> None:
    disc = sg.Parcel(sg.Disc(0.1))
    poses, velocities = [(1.0, 1.0, 0.0), (1.6, 1.1, 0.0)], [(2.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
    meeting = Meeting(ice(), [disc, disc], poses, velocities, restitution)
    while not meeting.step(1e-3):
        pass
    # The normal is 30 deg off the motion: slip 1.0 m/s, of which discs' spins take two thirds.
    np.testing.assert_allclose(meeting.velocity[:, 2], 10.0 / 3.0, rtol=1e-3)
    apart = np.diff(meeting.velocity[:, :2], axis=0)[0]
    cosine, sine = math.cos(math.pi / 6.0), math.sin(math.pi / 6.0)
    slip = cosine * apart[1] - sine * apart[0] - 0.1 * meeting.velocity[:, 2].sum()
    assert slip == pytest.approx(0.0, abs=1e-5)
    assert cosine * apart[0] + sine * apart[1] == pytest.approx(restitution * 3.0**0.5, abs=1e-4)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_sides_that_hit_each_other_flat_stop_sliding_once(restitution: float) -> None:
    box = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=2.0)
    poses = [(1.0, 1.0, 0.0), (1.25, 1.0, 0.0)]
    meeting = Meeting(ice(), [box, box], poses, [(1.0, 0.5, 0.0), (0, 0, 0)], restitution, 0.9)
    meeting.step(1e-4)
    # By an impulse along the side each gets 1 / m there, and 1.5 / m by turning.
    side = 0.5 / 5.0
    spin = -side * 0.125 / (0.25**2 / 6.0)
    slower, faster = 0.5 * (1.0 - restitution), 0.5 * (1.0 + restitution)
    expected = [(slower, 0.5 - side, spin), (faster, side, spin)]
    np.testing.assert_allclose(meeting.velocity, expected, atol=1e-6)


@pytest.mark.parametrize("restitution", [0.3, 1.0])
@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_a_row_of_boxes_that_hit_each_other_flat_gains_no_energy(
    restitution: float, friction: float
) -> None:
    rng = np.random.default_rng(0)
    for count in rng.integers(2, 6, 20):
        sizes = rng.uniform(0.2, 0.4, (count, 2))
        x = 0.5 + np.cumsum(sizes[:, 0]) - 0.5 * sizes[:, 0] + 1e-4 * np.arange(count)
        poses = np.column_stack([x, rng.uniform(1.4, 1.6, count), np.zeros(count)])
        velocities = rng.normal(size=(count, 3)) * [1.0, 0.5, 0.0]
        velocities[[0, -1], 0] = 2.0, -1.0
        who = [
            sg.Parcel(sg.Rectangle(*size), mass, com_offset=(0.02, -0.01))
            for size, mass in zip(sizes, np.exp(rng.uniform(-1.0, 2.0, count)), strict=True)
        ]
        meeting = Meeting(ice(), who, poses, velocities, restitution, friction)
        start = before = meeting.energy
        for _ in range(20):
            meeting.step(0.005)
            assert meeting.energy <= before + 1e-10 * start
            before = meeting.energy
