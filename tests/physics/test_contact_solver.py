"""Steps of several parcels: what they keep, what they never do, and whom they leave alone."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

import surface_gym as sg
from surface_gym.physics.rollout import distance_between
from surface_gym.physics.signed_distance import CONTACT_DISTANCE
from surface_gym.physics.step import BALANCED, OFF_SURFACE, UNSUPPORTED
from surface_gym.physics.types import AX, AY, VX, Array, X
from tests.strategies import parcels
from tests.worlds import G, Meeting, ice, supports

BOX = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=2.0)
DT = 0.005  # [s]
HEAD_ON = [(3.0, 0.0, 0.0), (-3.0, 0.0, 0.0)]  # [m/s, m/s, rad/s]


@st.composite
def crowds(draw: st.DrawFn, surface: sg.Surface) -> Meeting:
    """Two to six parcels around a place that all of them move towards."""
    count = draw(st.integers(2, 6))
    who = [draw(parcels()) for _ in range(count)]
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    around = 2.0 * math.pi * np.arange(count) / count
    away = np.column_stack([np.cos(around), np.sin(around), np.zeros(count)])
    farthest = max(each.base.reach + math.hypot(*each.base.centroid) for each in who)
    apart = farthest / math.sin(math.pi / count) + 0.05
    speed = draw(st.floats(0.2, 2.5))
    poses = (1.9, 1.5, 0.0) + apart * away + [0.0, 0.0, 1.0] * rng.uniform(-3, 3, (count, 1))
    velocities = speed * (-away + rng.normal(scale=0.2, size=(count, 3)))
    restitution = draw(st.sampled_from([0.0, 0.3, 1.0]))
    return Meeting(surface, who, poses, velocities, restitution, draw(st.sampled_from([0.0, 0.5])))


ROUGH = sg.Surface(
    np.random.default_rng(0).uniform(-3.0, 3.0, (30, 40)),
    np.random.default_rng(1).random((30, 40)) < 0.5,
    mu_max=0.3,
)


def overlap(meeting: Meeting) -> float:
    """[m] the most of any two parcels."""
    rows = range(len(meeting.masses))
    return max(-distance_between(meeting.world, i, j) for i in rows for j in range(i))


@given(meeting=crowds(ROUGH))
def test_energy_never_grows_on_the_level_and_nobody_is_left_inside(meeting: Meeting) -> None:
    before = start = meeting.energy
    for _ in range(60):
        meeting.step(DT)
        assert meeting.energy <= before + 1e-9 * start
        before = meeting.energy
        assert overlap(meeting) < 2e-3


@given(meeting=crowds(ice()))
def test_momentum_is_kept_where_nothing_rubs_below(meeting: Meeting) -> None:
    start = meeting.momentum[:2]
    scale = meeting.masses @ np.hypot(*meeting.velocity[:, :2].T)
    for _ in range(60):
        meeting.step(DT)
        assert np.abs(meeting.momentum[:2] - start).max() <= 1e-13 * scale


@given(who=st.tuples(parcels(), parcels()), offset=st.floats(-0.1, 0.1), spin=st.floats(-3.0, 3.0))
@pytest.mark.parametrize("restitution", [0.0, 0.3, 1.0])
def test_an_impact_keeps_angular_momentum(
    who: tuple[sg.Parcel, sg.Parcel], offset: float, spin: float, restitution: float
) -> None:
    one, other = who
    poses = [(1.3, 1.5, 0.4), (1.31 + one.base.reach + other.base.reach, 1.5 + offset, -1.0)]
    velocities = [(2.0, 0.0, spin), (-1.0, 0.1, -spin)]
    meeting = Meeting(ice(), [one, other], poses, velocities, restitution)
    start = meeting.momentum
    for _ in range(40):
        if meeting.step(DT):
            break
    if overlap(meeting) < 0.4 * CONTACT_DISTANCE:  # nobody was moved apart
        np.testing.assert_allclose(meeting.momentum, start, atol=1e-12 * np.abs(start).max())


@pytest.mark.parametrize("restitution", [0.0, 1.0])
@pytest.mark.parametrize("base", [sg.Disc(0.05), sg.Disc(0.4), sg.Rectangle(0.1, 0.1)])
@pytest.mark.parametrize("other", [sg.Disc(0.05), sg.Rectangle(0.5, 0.3), sg.Rectangle(0.1, 0.1)])
def test_none_passes_through_another(base: object, other: object, restitution: float) -> None:
    surface = sg.Surface(
        np.zeros((100, 100)), np.zeros((100, 100), dtype=bool), pitch=0.04, mu_support=0.01
    )
    poses, who = [(1.0, 2.0, 0.0), (1.7, 2.01, 0.2)], [sg.Parcel(base), sg.Parcel(other)]
    meeting = Meeting(surface, who, poses, HEAD_ON, restitution)
    touched = False
    for _ in range(60):
        touched |= bool(meeting.step(DT))
        assert meeting.place[0, 0] < meeting.place[1, 0]
    assert touched


def test_a_box_hits_a_box_before_it_passes_half_the_step() -> None:
    """2 cm apart at 3 m/s each they meet after 10/3 ms of the 5, and stop there."""
    meeting = Meeting(ice(), [BOX, BOX], [(1.0, 1.0, 0.0), (1.27, 1.0, 0.0)], HEAD_ON)
    ((_, _, impulse),) = meeting.step(DT)
    np.testing.assert_allclose(meeting.place[:, 0], [1.01, 1.26], atol=2e-6)
    np.testing.assert_allclose(meeting.velocity, 0.0, atol=1e-9)
    assert impulse == pytest.approx(6.0)


def test_islands_do_not_mix_and_whoever_touches_nobody_moves_as_alone() -> None:
    disc = sg.Parcel(sg.Disc(0.2), com_offset=(0.02, 0.01))
    who = [BOX, BOX, BOX, BOX, disc]
    poses = [(1.0, 0.9, 0.1), (1.3, 0.9, 0.3), (1.0, 2.0, 0.0), (1.27, 2.05, 0.0), (2.4, 1.4, 0.3)]
    velocities = [(1.0, 0.0, 0.2), (0, 0, 0), (0.7, 0.0, 0.4), (0, 0, 0), (1.0, -0.1, 0.5)]
    five = Meeting(ROUGH, who, poses, velocities)
    apart = [
        Meeting(ROUGH, who[some], poses[some], velocities[some])
        for some in (slice(2), slice(2, 4), slice(4, 5))
    ]
    met = set()
    for _ in range(60):
        touches = five.step(DT)
        first, second, third = (each.step(DT) for each in apart)
        assert touches == first + [(i + 2, j + 2, p) for i, j, p in second]
        assert third == []
        met |= {pair[:2] for pair in touches}
    assert met == {(0, 1), (2, 3)}
    states = np.concatenate([each.world.state for each in apart])
    assert five.world.state.tobytes() == states.tobytes()


def test_a_mirrored_meeting_goes_the_mirrored_way() -> None:
    mirror = np.array([1.0, -1.0, -1.0])
    who = [BOX, sg.Parcel(sg.Rectangle(0.4, 0.2), mass=5.0)]
    poses = np.array([(1.0, 0.1, 0.3), (1.5, 0.0, -0.2)])
    velocities = np.array([(1.5, 0.0, 0.5), (0.0, 0.1, 0.0)])
    shape = (31, 40)
    axis = np.broadcast_to(0.6 * np.sign(np.arange(31)[:, np.newaxis] - 15) + 0.3, shape)
    ends = []
    for turn, axes in ((np.ones(3), axis), (mirror, -axis[::-1])):
        surface = sg.Surface(axes, np.ones(shape, dtype=bool), origin=(0.05, -1.5), mu_max=0.1)
        meeting = Meeting(surface, who, poses * turn, velocities * turn)
        touched = sum(len(meeting.step(DT)) for _ in range(80))
        ends.append(np.hstack([meeting.place, meeting.velocity]) * np.tile(turn, 2))
        assert touched > 0
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-6)


def end(dt: float) -> Array:
    """Where a push leads, at a step."""
    who = [BOX, sg.Parcel(sg.Disc(0.15), mass=1.0)]
    meeting = Meeting(
        supports(0.1), who, [(1.0, 1.0, 0.2), (1.5, 1.05, 0.0)], [(1.5, 0, 0.3), (0, 0, 0)]
    )
    for _ in range(round(0.6 / dt)):
        meeting.step(dt)
    return meeting.place


def test_a_finer_step_converges() -> None:
    fine = end(1e-4)
    error = [np.abs(end(dt) - fine)[:, :2].max() for dt in (8e-3, 4e-3, 1e-3)]
    assert error[0] < 3e-3
    assert error[2] < 0.5 * error[0]
    assert error[2] < 5e-4


def test_sides_do_not_count_into_the_acceleration_that_loads_the_elements() -> None:
    mu = 0.1
    meeting = Meeting(
        supports(mu), [BOX, BOX], [(1.0, 1.0, 0.0), (1.26, 1.0, 0.0)], [(2.5, 0, 0), (-2.5, 0, 0)]
    )
    meeting.step(DT)
    np.testing.assert_allclose(np.abs(meeting.velocity[:, 0]), 0.0, atol=1e-7)
    assert np.abs(meeting.world.state[:, [AX, AY]]).max() <= mu * G * 1.000001


def test_who_is_off_the_surface_or_on_nothing_keeps_still_and_touches_nobody() -> None:
    coin = sg.Parcel(sg.Disc(0.04))
    meeting = Meeting(
        supports(0.1),
        [BOX, BOX, coin, BOX],
        [(-0.01, 1.0, 0.0), (0.2, 1.0, 0.0), (2.0, 1.0, 0.0), (2.15, 1.0, 0.0)],
        [(-1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)],
    )
    before = meeting.world.state.copy()
    assert meeting.step(DT) == []
    assert meeting.scratch.report.tolist() == [OFF_SURFACE, BALANCED, UNSUPPORTED, BALANCED]
    assert meeting.scratch.rotors.tolist() == [0, 0, 0, 0]
    np.testing.assert_array_equal(meeting.world.state[[0, 2]], before[[0, 2]])
    assert (meeting.world.state[[1, 3], X] < before[[1, 3], X]).all()


def test_rows_without_a_parcel_are_left_alone() -> None:
    poses = [(1.0, 1.0, 0.0), (1.1, 1.0, 0.0), (1.3, 1.0, 0.0)]
    meeting = Meeting(supports(0.1), [BOX] * 3, poses, [(1.0, 0, 0), (9.0, 9.0, 9.0), (0, 0, 0)])
    meeting.world.present[1] = False
    before = meeting.world.state[1].copy()
    touches = [meeting.step(DT) for _ in range(30)]
    assert {pair[:2] for each in touches for pair in each} == {(0, 2)}
    np.testing.assert_array_equal(meeting.world.state[1], before)


def test_a_step_says_how_many_rotors_bore_each() -> None:
    surface = sg.Surface(np.zeros((30, 40)), np.tile(np.arange(40) < 10, (30, 1)))
    meeting = Meeting(surface, [BOX] * 3, [(0.5, 1.0, 0.0), (1.0, 1.0, 0.0), (2.0, 1.0, 0.0)])
    meeting.step(DT)
    assert meeting.scratch.rotors.tolist() == [4, 2, 0]


def test_axes_that_turn_count_once_the_scratch_forgets() -> None:
    surface = sg.Surface(np.zeros((30, 40)), np.ones((30, 40), dtype=bool), mu_max=0.5, mu_min=0.0)
    meeting = Meeting(surface, [BOX] * 2, [(1.0, 1.0, 0.0), (2.0, 1.0, 0.0)], [(1.0, 0, 0)] * 2)
    meeting.step(DT)
    slowed = meeting.world.state[:, VX].copy()
    assert (slowed < 0.98).all()
    meeting.grid.direction[:] = 0.0, 1.0  # they roll along x
    meeting.forget()
    meeting.step(DT)
    np.testing.assert_allclose(meeting.world.state[:, VX], slowed, atol=1e-9)


def test_who_overlaps_is_moved_apart_the_heavier_less_and_no_faster() -> None:
    heavy = sg.Parcel(BOX.base, mass=3.0 * BOX.mass)
    poses = np.array([(1.0, 1.0, 0.0), (1.242, 1.0, 0.0)])
    meeting = Meeting(ice(), [BOX, heavy], poses)
    meeting.step(DT)
    moved = meeting.place - poses
    np.testing.assert_allclose(moved[:, 0], [-0.006, 0.002], atol=1e-6)
    np.testing.assert_array_equal(moved[:, 1:], 0.0)
    np.testing.assert_array_equal(meeting.velocity, 0.0)


def test_who_is_pushed_into_a_third_that_alone_it_would_not_reach_is_moved_out_of_it() -> None:
    disc = sg.Parcel(sg.Disc(0.1))
    poses = [(1.0, 1.0, 0.0), (1.201, 1.0, 0.0), (1.403, 1.0, 0.0)]
    meeting = Meeting(ice(), [disc] * 3, poses, [(2.0, 0.0, 0.0), (0, 0, 0), (0, 0, 0)], 1.0)
    meeting.step(DT)
    assert meeting.velocity[1, 0] == pytest.approx(2.0)
    assert overlap(meeting) <= CONTACT_DISTANCE
    assert len(meeting.step(DT)) > 0


@pytest.mark.parametrize("seed", range(3))
def test_a_crowd_that_leans_on_each_other_stays_whatever_the_order_of_its_rows(seed: int) -> None:
    # With axes along the slope: they hold three of the eight in a row.
    rotor = np.tile(np.arange(40) >= 16, (30, 1))
    surface = sg.Surface(np.zeros((30, 40)), rotor, tilt=math.radians(8.0))
    poses = np.array([(0.5 + 0.25 * (k % 8), 0.5 + 0.25 * (k // 8), 0.0) for k in range(24)])
    np.random.default_rng(seed).shuffle(poses)
    meeting = Meeting(surface, [BOX] * 24, poses)
    for _ in range(10):
        assert len(meeting.step(DT)) > 0
    np.testing.assert_allclose(meeting.place, poses, atol=1e-5)
    assert np.abs(meeting.velocity).max() < 1e-5
