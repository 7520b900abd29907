"""Two parcels that push each other: MuJoCo against the analytic model."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.validation import drawn
from surface_gym.validation.simulation import simulate_together

pytest.importorskip("mujoco", reason="MuJoCo, of the extra `validation`, is not installed")

SURFACE = sg.Surface(np.zeros((12, 14)), np.zeros((12, 14), dtype=bool))
POSES = [(0.3, 0.6, 0.0), (0.6, 0.6, 0.0)]
EVERYWHERE = np.ones((12, 14), dtype=bool)
PARCEL = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=2.0, com_height=0.05)


@pytest.mark.parametrize("seed", [3, 6, 8, 19])
def test_drawn_meetings_end_as_in_mujoco(seed):
    meeting = drawn.Meeting(seed)
    mujoco = np.array([trajectory.pose[-1] for trajectory in meeting.mujoco()])
    for dt, distance, angle in ((1e-3, 1.0, 0.5), (5e-3, 2.0, 1.0)):
        ends = [trajectory.pose[-1] for trajectory in meeting.analytic(dt).trajectories]
        millimetres, degrees = drawn.apart(drawn.UNIT * (np.array(ends) - mujoco))
        assert millimetres < distance
        assert degrees < angle


def test_the_parcels_of_a_meeting_touch_on_the_surface():
    seen = set()
    for seed in range(8):
        meeting = drawn.Meeting(seed)
        _, parcels, poses, velocities = meeting.drawn
        encounter = meeting.analytic(2e-3)
        seen |= {type(parcel.base) for parcel in parcels}
        assert len(encounter.touches.time) > 0
        assert {trajectory.end for trajectory in encounter.trajectories} == {"duration"}
        assert poses.shape == velocities.shape == (2, 3)
        assert 0.5 <= velocities[0, 0] <= 2.0
    assert seen == {sg.Rectangle, sg.Disc, sg.Polygon}


@pytest.mark.parametrize("base", [sg.Rectangle(0.25, 0.25), sg.Disc(0.125)], ids=["box", "disc"])
def test_what_has_hit_in_mujoco_stays_together(base):
    parcel = sg.Parcel(base, mass=2.0, com_height=0.05)
    velocities = [(1.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
    runs = simulate_together(SURFACE, [parcel] * 2, POSES, velocities, 0.2, EVERYWHERE)
    pushed = [run.velocity[-1, 0] for run in runs]
    np.testing.assert_allclose(pushed, 0.49, atol=0.01)
    assert runs[1].pose[-1, 0] - runs[0].pose[-1, 0] == pytest.approx(0.25, abs=5e-4)
    assert not any(run.tipping.any() for run in runs)


def test_a_run_that_diverges_is_named_and_what_is_not_allowed_refused(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log where it is
    motion = [(1e11, 0.0, 0.0), (0.0, 0.0, 0.0)]  # beyond what MuJoCo takes for a number
    with pytest.raises(RuntimeError, match=r"diverged at a step of 2e-05 s .* a smaller step"):
        simulate_together(SURFACE, [PARCEL] * 2, POSES, motion, 0.001, EVERYWHERE)
    poses, still = [(0.3, 0.6, 0.0)], [(0.0, 0.0, 0.0)]
    for count, velocities, duration, message in (
        (2, still, 0.1, r"poses must have the shape \(2, 3\), got \(1, 3\)"),
        (1, [0.0], 0.1, r"velocities must have the shape \(1, 3\), got \(1,\)"),
        (1, still, 0, "duration must be greater than 0, got 0"),
    ):
        with pytest.raises(ValueError, match=message):
            simulate_together(SURFACE, [PARCEL] * count, poses, velocities, duration, EVERYWHERE)
