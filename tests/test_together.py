"""`simulate_together` against `simulate`, what can be computed by hand, and bad arguments."""

import math

import numpy as np
import pytest
from hypothesis import given

import surface_gym as sg
from tests.strategies import scenes
from tests.worlds import G, quarter_turned, supports

BOX = sg.layouts.box("S")
POSES = [(1.0, 1.0, 0.0), (1.5, 1.0, 0.0)]
TOWARDS = [(1.0, 0.0, 0.0), (0.0, 0.0, 0.0)]


@given(scene=scenes())
def test_one_parcel_goes_as_by_simulate_to_the_bit(scene):
    alone = scene.run(0.2517)
    together = sg.simulate_together(
        scene.surface, [scene.parcel], [scene.pose], [scene.velocity], 0.2517
    )
    same(together.trajectories[0], alone)
    assert len(together.touches.time) == 0


def same(one: sg.Trajectory, other: sg.Trajectory) -> None:
    for name in ("time", "pose", "velocity", "tipping"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    assert one.end == other.end


@pytest.mark.parametrize(("duration", "dt"), [(0.5, 0.005), (0.5017, 0.005), (0.004, 0.005)])
def test_parcels_that_never_touch_go_as_by_simulate_to_the_bit(duration, dt):
    surface = sg.layouts.sorting(tilt=math.radians(5.0))
    parcels = [BOX, sg.Parcel(sg.Disc(0.2), mass=3.0, com_offset=(0.02, 0.0)), BOX]
    poses = [(0.5, 1.01, 0.3), (1.2, 0.9, 0.0), (0.5, 0.5, 0.0)]
    velocities = [(1.0, 0.1, -0.5), (1.2, 0.0, 1.0), (0.0, 0.0, 0.0)]
    encounter = sg.simulate_together(surface, parcels, poses, velocities, duration, dt)
    for trajectory, *start in zip(encounter.trajectories, parcels, poses, velocities, strict=True):
        same(trajectory, sg.simulate(surface, *start, duration, dt))


def test_touches_say_who_pushed_whom_when_and_how_hard():
    encounter = sg.simulate_together(
        supports(0.0), [BOX] * 3, [*POSES, (1.0, 2.0, 0.0)], [*TOWARDS, (0, 0, 0)], restitution=0.5
    )
    touches = encounter.touches
    np.testing.assert_allclose(touches.time, [0.25], atol=0.005 + 1e-9)
    assert touches.pair.tolist() == [[0, 1]]
    np.testing.assert_allclose(touches.impulse, [1.5 * BOX.mass / 2.0])
    ends = [trajectory.velocity[-1, 0] for trajectory in encounter.trajectories]
    np.testing.assert_allclose(ends, [0.25, 0.75, 0.0], atol=1e-8)


def test_those_that_touch_on_a_slope_to_the_side_move_as_on_one_ahead():
    rotor = np.zeros((40, 40), dtype=bool)
    rotor[:, 22:] = True  # with axes along the slope: they hold who comes
    ahead = sg.Surface(np.zeros((40, 40)), rotor, mu_support=0.05, tilt=math.radians(8.0))
    poses = np.array([(1.0, 2.0, 0.1), (1.4, 1.9, 0.0), (2.6, 2.0, 0.0)])
    velocities = np.array([(0.8, 0.0, 0.5), (0.3, 0.1, 0.0), (0.0, 0.0, 0.0)])
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    others = poses @ turned + [0.0, 0.0, math.pi / 2], velocities @ turned
    one = sg.simulate_together(ahead, [BOX] * 3, poses, velocities, 1.0)
    other = sg.simulate_together(quarter_turned(ahead), [BOX] * 3, *others, 1.0)
    assert len(one.touches.time) > 10
    np.testing.assert_array_equal(other.touches.time, one.touches.time)
    np.testing.assert_allclose(other.touches.impulse, one.touches.impulse, rtol=0.0, atol=1e-7)
    for first, second in zip(one.trajectories, other.trajectories, strict=True):
        expected = first.pose @ turned + [0.0, 0.0, math.pi / 2]
        np.testing.assert_allclose(second.pose, expected, rtol=0.0, atol=1e-9)


def test_there_is_room_for_any_number_of_touches():
    rotor = np.zeros((20, 40), dtype=bool)
    rotor[:, 22:] = True  # with axes along the slope: they hold the last
    surface = sg.Surface(np.zeros((20, 40)), rotor, tilt=math.radians(8.0))
    poses = [(1.0 + 0.25 * k, 1.0, 0.0) for k in range(6)]
    encounter = sg.simulate_together(surface, [BOX] * 6, poses, duration=0.5, dt=5e-4)
    touches = encounter.touches
    assert len(touches.time) > 2000
    assert (np.diff(touches.time) >= 0.0).all()
    assert (touches.impulse > 0.0).all()
    assert (touches.pair[:, 0] < touches.pair[:, 1]).all()
    assert touches.time.shape == touches.impulse.shape == touches.pair.shape[:1]


def test_whoever_leaves_ends_there_and_the_others_go_on():
    poses = [(3.8, 1.0, 0.0), (1.0, 1.0, 0.0)]
    encounter = sg.simulate_together(supports(0.01), [BOX] * 2, poses, [(1.0, 0, 0)] * 2, 0.5)
    gone, stays = encounter.trajectories
    assert gone.end == "left the surface"
    assert gone.pose[-1, 0] <= 4.0
    assert gone.time[-1] == pytest.approx(0.2, abs=0.01)
    assert stays.end == "duration"
    same(stays, sg.simulate(supports(0.01), BOX, poses[1], (1.0, 0.0, 0.0), 0.5))


def test_frames_off_the_centroid_touch_where_their_bases_do():
    corner = sg.Parcel(sg.Polygon([(0.0, 0.0), (0.25, 0.0), (0.25, 0.25), (0.0, 0.25)]))
    centred, cornered = (
        sg.simulate_together(supports(0.1), [parcel] * 2, poses, TOWARDS, 0.5)
        for parcel, poses in (
            (BOX, np.array(POSES)),
            (corner, np.array(POSES) - [0.125, 0.125, 0.0]),
        )
    )
    np.testing.assert_allclose(cornered.touches.time, centred.touches.time)
    for one, other in zip(centred.trajectories, cornered.trajectories, strict=True):
        np.testing.assert_allclose(other.pose, one.pose - [0.125, 0.125, 0.0], atol=1e-6)


def test_two_stop_together_after_the_way_that_friction_leaves_them():
    """The impact halves the speed; from there on v^2 / (2 mu g)."""
    mu, gap = 0.2, 0.1
    parcel = sg.Parcel(sg.Rectangle(0.4, 0.4), com_height=0.0)
    poses = [(1.0, 1.0, 0.0), (1.4 + gap, 1.0, 0.0)]
    encounter = sg.simulate_together(supports(mu), [parcel] * 2, poses, [(2.0, 0, 0), (0, 0, 0)])
    common = math.sqrt(2.0**2 - 2.0 * mu * G * gap) / 2.0
    way = common**2 / (2.0 * mu * G)
    ends = [trajectory.pose[-1, 0] for trajectory in encounter.trajectories]
    np.testing.assert_allclose(ends, [1.0 + gap + way, 1.4 + gap + way], atol=1e-3)


SPOILT = [
    ({"surface": None}, "surface must be a Surface, got None"),
    ({"parcels": BOX}, "parcels must be a sequence of Parcel, got Parcel"),
    ({"parcels": [BOX, "box"]}, "parcels must be a sequence of Parcel, got .*'box'"),
    ({"parcels": []}, "parcels must be at least one, got none"),
    ({"parcels": [BOX]}, r"poses must have the shape \(1, 3\), got \(2, 3\)"),
    ({"poses": POSES[0]}, r"poses must have the shape \(2, 3\), got \(3,\)"),
    ({"velocities": TOWARDS[:1]}, r"velocities must have the shape \(2, 3\), got \(1, 3\)"),
    ({"dt": 1e-6, "duration": 1000.0}, "dt must be at least duration / 100_000_000, got 1e-06"),
    ({"poses": [POSES[0], (9.0, 1.0, 0.0)]}, r"poses must be on the surface, .* of parcel 1"),
    ({"parcels": [sg.Parcel(sg.Disc(0.04)), BOX]}, "poses must be over an element, .* of parcel 0"),
    ({"poses": [POSES[0], (1.2, 1.1, 0.0)]}, "poses must leave parcels apart, got 0 and 1 that"),
    ({"velocities": [(0.0, 30.0, 0.0)] * 2}, "dt must be so short that no step moves the parcel"),
]


@pytest.mark.parametrize(("change", "message"), SPOILT)
def test_what_is_not_allowed_is_refused(change, message):
    arguments = {"surface": supports(0.01), "parcels": [BOX] * 2, "poses": POSES, **change}
    with pytest.raises(ValueError, match=message):
        sg.simulate_together(**arguments)


def test_a_base_that_covers_too_many_elements_is_refused():
    shape = (80, 80)
    surface = sg.Surface(np.zeros(shape), np.ones(shape, dtype=bool), pitch=0.01)
    with pytest.raises(ValueError, match="base must cover at most 4096 elements"):
        sg.simulate_together(surface, [sg.Parcel(sg.Disc(2.0))], [(0.4, 0.4, 0.0)])


def test_parcels_may_start_side_by_side():
    encounter = sg.simulate_together(supports(0.1), [BOX] * 2, [POSES[0], (1.25, 1.0, 0.0)])
    assert len(encounter.touches.time) == 0
    for trajectory in encounter.trajectories:
        np.testing.assert_array_equal(trajectory.pose[-1], trajectory.pose[0])
