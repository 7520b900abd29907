"""Forces that recordings of streams hold: they change the motion that is recorded beside them."""

import gymnasium as gym
import numpy as np
import pytest

from surface_gym.recorder import RecordReplay
from surface_gym.recording import CONTACT, PUSH, Recording

STEP = 0.002  # [s] of the physics, and between frames here


def converging(task: str, steps: int) -> tuple[Recording, list[float], np.ndarray]:
    """Lead one half of a zone into the other: the recording, masses [kg], gravity."""
    env = RecordReplay(gym.make(f"SmartSurface/{task}-v0", control_period=STEP))
    batch = env.unwrapped.batch
    _, info = env.reset(seed=1)
    assert (batch.params.timing.dt, batch.params.timing.steps) == (STEP, 1)
    degrees = np.degrees(batch.params.acting.orientations).round().tolist()
    _, rows, _, columns = batch.bodies.zone[0].tolist()
    halves = np.where(np.arange(rows) < rows / 2, degrees.index(90.0), degrees.index(45.0))
    action = np.repeat(halves, columns)
    masses: dict[int, float] = {}  # by number, in the order in which they appear
    for _ in range(steps):
        for slot, number in enumerate(info["parcels"].tolist()):
            if number >= 0:
                masses[number] = batch.parcel(0, slot).mass
        *_, info = env.step(action)
    return env.recording, list(masses.values()), batch.surfaces.conditions[0, 3:5]


@pytest.fixture(scope="module")
def merged():
    return converging("Singulate", 2500)


def totals(found: Recording, frame: int) -> np.ndarray:
    """The sum of forces [N] on each parcel of a frame."""
    total = np.zeros((len(found.parcels), 2))
    for k in range(found.first_contact[frame], found.first_contact[frame + 1]):
        total[found.bearer[k]] += found.contacts[k, 2:]
    for first, second, _, _, fx, fy in found.pushes[slice(*found.first_push[frame : frame + 2])]:
        total[int(first)] -= (fx, fy)
        total[int(second)] += (fx, fy)
    return total


def test_friction_gravity_and_pushes_are_mass_times_acceleration(merged):
    found, masses, gravity = merged
    compared = 0
    for frame in range(1, len(found) - 1):  # from the first command on, axes stay
        total = totals(found, frame)
        for number, parcel in enumerate(found.parcels):
            row = frame - parcel.first
            if 0 <= row < len(parcel.velocity) - 1:
                gained = np.diff(parcel.velocity[row : row + 2, :2], axis=0)[0] / STEP
                force = total[number] + masses[number] * gravity
                assert force == pytest.approx(masses[number] * gained, abs=2e-3)
                compared += 1
    assert compared > 2000
    assert len(found.pushes) > 100


def test_parcels_push_each_other_where_they_meet(merged):
    found, _, _ = merged
    for frame in range(1, len(found)):
        for first, second, x, y, *_ in found.pushes[slice(*found.first_push[frame : frame + 2])]:
            for number in (first, second):
                parcel = found.parcels[int(number)]
                px, py, theta = parcel.pose[frame - parcel.first]
                cosine, sine = np.cos(theta), np.sin(theta)
                place = [cosine * (x - px) + sine * (y - py), cosine * (y - py) - sine * (x - px)]
                assert (np.abs(place) < np.abs(parcel.outline).max(axis=0) + 0.003).all()


def test_each_parcel_is_carried(merged):
    found, masses, _ = merged
    for frame in range(0, len(found), 100):
        rows = slice(*found.first_contact[frame : frame + 2])
        carried = np.bincount(found.bearer[rows], found.contacts[rows, 1], len(found.parcels))
        for number, parcel in enumerate(found.parcels):
            if parcel.first <= frame < parcel.first + len(parcel.pose) - 1:
                assert carried[number] == pytest.approx(masses[number] * 9.81, rel=1e-2)


def test_a_file_keeps_them(merged):
    found, _, _ = merged
    again = Recording.decode(found.encode())
    assert again.bearer.tolist() == found.bearer.tolist()
    assert again.first_push.tolist() == found.first_push.tolist()
    assert np.abs((again.contacts - found.contacts) / CONTACT).max() <= 0.5001
    assert np.abs((again.pushes - found.pushes) / PUSH).max() <= 0.5001


def test_recording_them_leaves_the_stream_as_it_is():
    ends = []
    for watched in (True, False):
        env = gym.make("SmartSurface/Singulate-v0")
        env = RecordReplay(env) if watched else env
        env.reset(seed=3)
        for _ in range(50):
            env.step(np.full(env.action_space.shape, 3))
        ends.append(env.unwrapped.batch.parcels.state.tobytes())
    assert ends[0] == ends[1]
