"""The estimate is that of the package's own filter, however late frames arrive."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.runtime import estimator as estimators
from surface_gym.config import EnvConfig
from surface_gym.machine.messages import Frame, ParcelEntry
from tests.agents.runtime import made
from tests.environments import begun

CAMERA = sg.sensors.Camera(latency=0.0)
AT = 100.0  # [s] when the parcel enters
PERIOD = 0.02  # [s] that of the camera


def commands(actions: list[int]) -> np.ndarray:
    return made.CONFIG.action_kind.commands(np.array(actions), len(actions))


@pytest.fixture
def held() -> estimators.StateEstimator:
    return made.estimator()


@pytest.fixture(scope="module")
def filtered() -> tuple[ParcelEntry, list[np.ndarray], list[Frame], list[np.ndarray]]:
    """What the environment's own filter makes of frames that are not late: the entry, and for each
    period the command, the frame at its end and the observation then.
    """
    batch = begun(replace(made.CONFIG, sensors=CAMERA, control_period=PERIOD), seed=3)
    parcels = batch.parcels
    about = parcels.sensor_state[0, :6].copy()
    size = 2.0 * float(-batch.view(0).corners[:, 0].min())
    parcel = sg.Parcel(sg.Rectangle(size, size))
    start = ParcelEntry(0, AT, parcel, about[:3], about[3:], tuple(parcels.goal[0]))
    sent, frames, seen = [], [], [parcels.observation[0].copy()]
    rng = np.random.default_rng(0)
    spread = np.array([CAMERA.position_noise] * 2 + [CAMERA.angle_noise])
    for k in range(20):
        sent.append(commands([int(rng.integers(16))]))
        batch.step(sent[-1])
        noise = parcels.noise[0, parcels.noise_row[0, 0] - 1, :3]
        pose = parcels.truth[0, :3] + spread * noise
        frames.append(Frame(AT + PERIOD * (k + 1), 0, tuple(pose.tolist())))
        seen.append(parcels.observation[0].copy())
    return start, sent, frames, seen


def test_it_observes_what_the_environment_does(held, filtered) -> None:
    start, sent, frames, seen = filtered
    resolver = held.resolver(made.CONFIG.action_kind)
    held.reset(start)
    np.testing.assert_allclose(held.observe(AT), seen[0], rtol=0.0, atol=1e-6)
    for k, (command, taken) in enumerate(zip(sent, frames, strict=True)):
        held.resolve(resolver, command[0])
        held.note_sent(k, AT + PERIOD * k)
        assert held.correct(taken)
        np.testing.assert_allclose(held.observe(taken.taken_at), seen[k + 1], rtol=0.0, atol=1e-5)


def test_late_frames_lead_to_the_same_estimate(held, filtered) -> None:
    start, _, frames, _ = filtered
    estimates = []
    for late in (False, True):
        held.reset(start)
        for taken in frames:
            if not late:
                held.observe(taken.taken_at)
            assert held.correct(taken)
        held.observe(frames[-1].taken_at + 0.03)
        estimates.append(held.estimate)
    np.testing.assert_array_equal(*estimates)


def test_frames_out_of_order_or_of_another_parcel_are_of_no_use(held) -> None:
    held.reset(made.entered())
    assert held.correct(made.frame(0.04))
    before = held.observe(0.05)
    assert not held.correct(made.frame(0.02))
    assert not held.correct(made.frame(0.06, number=1))
    np.testing.assert_array_equal(held.observe(0.05), before)
    held.clear()
    assert not held.correct(made.frame(0.08))


def test_a_frame_draws_the_estimate_towards_it(held) -> None:
    held.reset(made.entered())
    held.observe(0.1)
    free = held.estimate[0]
    held.correct(made.frame(0.1, x=made.POSE[0] + 0.11))
    held.observe(0.1)
    assert free < held.estimate[0] < made.POSE[0] + 0.11


def test_axes_turn_as_fast_as_the_machine_says(held) -> None:
    resolver = held.resolver(made.CONFIG.action_kind)
    held.reset(made.entered())
    held.observe(0.0)
    rolling = held.resolve(resolver, commands([made.ROLL])[0])
    assert held.longest_turn(rolling) == 0.0
    angles = held.resolve(resolver, commands([made.BRAKE])[0])
    turned = angles != math.pi / 2.0
    assert (angles[turned] == 0.0).all()
    assert turned.sum() == 2 * 16  # a small parcel's line has two rows
    assert held.longest_turn(angles) == pytest.approx(made.QUARTER_TURN)
    held.note_sent(1, 0.01)
    for part, angle in ((0.5, math.pi / 4.0), (1.0, 0.0)):
        held.observe(0.01 + part * made.QUARTER_TURN)
        np.testing.assert_allclose(held.axes()[turned], angle, atol=1e-12)


def test_the_device_reports_when_axes_began_to_turn(held) -> None:
    resolver = held.resolver(made.CONFIG.action_kind)
    for at, expected in ((0.01, math.pi / 4.0), (0.01 + 0.5 * made.QUARTER_TURN, math.pi / 2.0)):
        held.reset(made.entered())
        held.observe(0.0)
        turned = held.resolve(resolver, commands([made.BRAKE])[0]) == 0.0
        held.note_sent(1, 0.0)
        held.acknowledge(1, at)
        held.observe(0.01 + 0.5 * made.QUARTER_TURN)
        np.testing.assert_allclose(held.axes()[turned], expected)
    held.drop_command(1)
    held.observe(1.0)
    assert (held.axes() == math.pi / 2.0).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_parcel_slides_down_a_surface_that_is_steep_across_the_line(held, side) -> None:
    held.reset(made.entered(tilt=0.7, tilt_direction=side * math.pi / 2.0))
    held.observe(0.3)
    free = 0.5 * 9.81 * math.sin(0.7) * 0.3**2  # without friction
    assert 0.3 * free < side * (held.estimate[1] - made.POSE[1]) < free


def test_encoders_are_believed(held) -> None:
    held.reset(made.entered())
    assert held.correct(replace(made.frame(0.02), axes=np.full(held.shape, 0.3)))
    held.observe(0.02)
    assert sorted(held.axes().ravel().tolist()) == [0.3] * 2 * 16 + [math.pi / 2.0] * 2 * 16
    along = held._surfaces.direction[estimators.SEEN] - (math.cos(0.3), math.sin(0.3))
    assert (np.abs(along).max(axis=-1) < 1e-12).sum() == 2 * 16


def test_without_frames_the_estimate_stands_still_in_the_end(held) -> None:
    held.reset(made.entered(velocity=(0.05, 0.0, 0.0)))
    held.observe(estimators.MAX_LATE)
    stands = held.estimate
    held.observe(100.0)
    np.testing.assert_array_equal(held.estimate, stands)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"goal": (1.0, 2.0)}, "goal"),
        ({"pose": (0.0, math.nan, 0.0)}, "pose"),
        ({"velocity": (1e9, 0.0, 0.0)}, "velocity"),
        ({"parcel": sg.Parcel(sg.Rectangle(1.9, 0.3))}, "long"),
    ],
)
def test_a_parcel_that_is_not_of_the_task_is_refused(held, changed, message) -> None:
    with pytest.raises(ValueError, match=message):
        held.reset(replace(made.entered(), **changed))


@pytest.mark.parametrize(
    ("task", "goal"),
    [
        ("sort", (0.5,)), ("sort", (2.0,)), ("stop", (1e5,)), ("orient", (4.0,)),
        ("slow", (1.5, 1.0)), ("slow", (0.5, 0.0)), ("track", (1.0, 0.0, 0.0)),
        ("track", (-1.0, 0.0, 0.1)), ("park", (1.0, 0.8, 4.0)), ("park", (1.0, 1e5, 0.0)),
    ],
)  # fmt: skip
def test_a_goal_that_no_start_has_is_refused(task, goal) -> None:
    batch = begun(EnvConfig(task=task), 4)
    for each in batch.parcels.goal:
        batch.task.check_goal(each)
    with pytest.raises(ValueError, match="goal"):
        batch.task.check_goal(np.array(goal))


def test_a_frame_with_numbers_that_are_not_allowed_is_refused(held) -> None:
    held.reset(made.entered())
    with pytest.raises(ValueError, match="pose"):
        held.correct(made.frame(0.02, x=math.inf))
    with pytest.raises(ValueError, match="axes"):
        held.correct(replace(made.frame(0.02), axes=np.zeros((2, 2))))


def test_the_camera_of_an_exact_sensor_is_ideal_and_one_without_frames_is_refused() -> None:
    assert estimators.device_camera(sg.sensors.Exact()) is estimators.IDEAL
    assert estimators.device_camera(made.CONFIG.sensors) is made.CONFIG.sensors
    with pytest.raises(ValueError, match="sensors must be a Camera"):
        estimators.StateEstimator(replace(made.CONFIG, sensors=sg.sensors.Presence()))


def test_driven_modules_are_refused() -> None:
    with pytest.raises(ValueError, match="modules must be idle in real time, got 'omni'"):
        estimators.StateEstimator(EnvConfig("stop", actions="halves", modules="omni"))


def test_an_axis_turned_by_half_a_turn_is_the_same() -> None:
    angles = np.array([-0.5, 0.5, 0.75, -1.25]) * math.pi
    expected = np.array([-0.5, 0.5, -0.25, -0.25]) * math.pi
    np.testing.assert_allclose(estimators.within_right_angles(angles), expected)
