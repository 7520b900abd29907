"""Recordings: what they hold, their files, and what is refused."""

import tracemalloc
import zlib
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym.recorder import RecordReplay, record_trajectory
from surface_gym.recording import Mark, RecordedParcel, Recording, index_axes, index_drives

BOX = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=10.0)


def recording(**changes):
    count = changes.pop("frames", 3)
    known = {
        "title": "Test",
        "control_period": 0.04,
        "time": 0.04 * np.arange(count),
        "rotor": np.ones((2, 3), dtype=bool),
        "angles": np.array([0.0, 1.5]),
        "axis": np.arange(6 * count, dtype=np.uint8).reshape(count, 2, 3) % 2,
        "parcels": (
            RecordedParcel(BOX.base.outline, 1, np.full((2, 3), 0.1), np.ones((2, 3)), "A", 4),
        ),
    }
    return Recording(**known | changes)


def assert_close(one, other):
    assert one.outcome == other.outcome
    assert one.axis.tolist() == other.axis.tolist()
    assert len(one.parcels) == len(other.parcels)
    np.testing.assert_allclose(one.angles[one.axis], other.angles[other.axis], atol=1e-6)
    np.testing.assert_allclose(one.time, other.time, atol=6e-6)
    np.testing.assert_allclose(one.contacts, other.contacts, atol=0.011)
    for name, values in one.metrics.items():
        np.testing.assert_allclose(values, other.metrics[name], rtol=1e-6)
    for first, second in zip(one.parcels, other.parcels, strict=True):
        assert (first.first, first.label, first.colour) == (
            second.first, second.label, second.colour,
        )  # fmt: skip
        np.testing.assert_allclose(first.pose, second.pose, atol=6e-5)
        np.testing.assert_allclose(first.velocity, second.velocity, atol=6e-4)


@pytest.fixture(scope="module")
def sorted_parcel():
    env = RecordReplay(gym.make("SmartSurface/Sort-v0", actions="halves"))
    env.reset(seed=0, options={"speed": 1.5, "parcel": "S", "side": 1})
    poses, over = [env.unwrapped.batch.parcels.truth[0, :3].copy()], False
    while not over:
        _, _, terminated, truncated, info = env.step(10)
        poses.append(info["pose"])
        over = terminated or truncated
    return env.recording, np.array(poses), info


def test_an_episode_is_recorded_frame_by_frame(sorted_parcel):
    found, poses, info = sorted_parcel
    (parcel,) = found.parcels
    assert parcel.pose.tolist() == poses.tolist()
    assert found.outcome == "success"
    assert found.time[-1] == pytest.approx(info["time"])
    assert found.metrics["reward_success"][-1] == info["reward_success"]
    assert {mark.kind for mark in found.marks} == {"zone", "exit"}
    turned = found.angles[found.axis[-1]][found.obeys]
    assert np.degrees(turned) % 180.0 == pytest.approx(135.0)


def test_the_forces_of_a_parcel_carry_and_slow_it(sorted_parcel):
    found, _, _ = sorted_parcel
    for k in range(3):
        contacts = found.contacts[found.first_contact[k] : found.first_contact[k + 1]]
        assert contacts[:, 1].sum() == pytest.approx(9.81 * 10.0, rel=1e-6)
    friction, velocity = contacts[:, 2:].sum(axis=0), found.parcels[0].velocity[k, :2]
    assert friction @ velocity < 0.0


def test_a_stream_is_recorded_with_each_of_its_parcels():
    env = RecordReplay(gym.make("SmartSurface/Flow-v0"))
    env.reset(seed=0)
    for _ in range(150):
        *_, info = env.step(np.full(env.action_space.shape, 3))
    found = env.recording
    assert len(found.parcels) == info["entered"] > 1
    assert {parcel.colour for parcel in found.parcels} <= set(range(found.delivered.shape[1]))
    last = found.parcels[-1]
    slot = info["parcels"].tolist().index(len(found.parcels) - 1)
    assert last.pose[-1].tolist() == env.unwrapped.batch.parcels.truth[slot, :3].tolist()
    assert found.metrics["entered"][-1] == info["entered"]
    assert_close(found, Recording.decode(found.encode()))


def test_a_trajectory_is_recorded_with_its_forces():
    run = sg.simulate(sg.layouts.sorting(), BOX, (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
    found = record_trajectory(run)
    assert found.time[-1] == run.time[-1]
    assert found.outcome == run.end
    row = int(np.searchsorted(run.time, found.time[10]))
    contacts = found.contacts[found.first_contact[10] : found.first_contact[11]]
    assert contacts[:, 2:].tolist() == run.contacts.of_step(row).force.tolist()
    with pytest.raises(ValueError, match="run is None"):
        record_trajectory(replace(run, run=None))


def test_a_file_gives_the_same_again(tmp_path, sorted_parcel):
    found, _, _ = sorted_parcel
    found.save(tmp_path / "run.replay")
    again = Recording.load(tmp_path / "run.replay")
    assert_close(found, again)
    again.save(tmp_path / "again.replay")
    assert (tmp_path / "run.replay").read_bytes() == (tmp_path / "again.replay").read_bytes()


def test_a_file_without_bearers_is_read_too(sorted_parcel):
    found, _, _ = sorted_parcel
    content = zlib.decompress(found.encode())
    count = len(found.contacts)
    after = (  # contacts, and what follows
        5 * 4 * count + 5 * len(found) + 4 * len(found) * len(found.metrics)
    )
    old = content[: -after - 5 * count] + content[-after:]
    pushes = 5 * len(found)
    end = len(old) - 4 * len(found) * len(found.metrics)
    old = old[: end - pushes] + old[end:]
    again = Recording.decode(zlib.compress(old.replace(b'"version":2', b'"version":1')))
    assert_close(found, again)
    assert (again.bearer == 0).all()


def test_an_empty_recording_is_one():
    alone = recording(frames=1, parcels=())
    assert_close(alone, Recording.decode(alone.encode()))


def test_each_episode_asked_for_becomes_a_page(tmp_path):
    env = RecordReplay(
        gym.make("SmartSurface/Sort-v0", actions="halves"), tmp_path, lambda k: k == 1, "run"
    )
    with pytest.raises(ValueError, match="recording must be asked for after reset"):
        _ = env.recording
    for seed in range(3):
        env.reset(seed=seed)
        env.step(0)
    env.close()
    assert [path.name for path in tmp_path.iterdir()] == ["run-episode-1.html"]


def test_axes_are_indices_and_half_a_turn_is_the_same_axis():
    angles, index = index_axes(np.array([0.0, np.pi / 4, -np.pi / 4, np.pi, 0.75 * np.pi]))
    assert np.degrees(angles).round().tolist() == [0, 45, 135]
    assert index.tolist() == [0, 1, 2, 0, 2]
    angles, index = index_axes(np.linspace(-1.5, 1.5, 1000))
    assert len(angles) <= 180
    apart = angles[index] - np.linspace(-1.5, 1.5, 1000)
    assert np.abs(np.sin(apart)).max() <= np.radians(0.51)


def test_velocities_of_driven_modules_are_indices_and_come_back_from_a_file():
    rng, idle = np.random.default_rng(0), np.full((1, 2, 2), np.nan)
    few = np.concatenate([idle, [[[1.0, 0.0], [0.3, -0.4]]]])
    for velocity, off in ((few, 1e-9), (rng.uniform(-2.0, 2.0, (100, 50, 2)), 0.33)):
        velocities, index = index_drives(velocity)
        np.testing.assert_allclose(velocities[index], velocity, atol=off)
    run = sg.simulate(
        sg.Surface(
            np.full((6, 12), 0.5 * np.pi), np.ones((6, 12), dtype=bool),
            surface_velocity=np.where(np.arange(12)[:, None] < 6, [0.5, 0.1], np.nan)
            * np.ones((6, 1, 1)),
        ),
        BOX, (0.3, 0.3, 0.0), (0.5, 0.1, 0.0),
    )  # fmt: skip
    found = record_trajectory(run)
    again = Recording.decode(found.encode())
    assert_close(found, again)
    assert again.velocities[again.drive[-1, 1, 5]].tolist() == pytest.approx([0.5, 0.1])
    assert np.isnan(again.velocities[again.drive[-1, 1, 6]]).all()


BAD = {
    "time": (np.array([0.0, 0.2, 0.1]), "time must hold at least one frame, and rise"),
    "axis": (np.zeros((3, 2, 2), dtype=np.uint8), "axis must be uint8 of the shape"),
    "angles": (np.array([0.0]), "axis must be indices among angles"),
    "velocities": (np.zeros((1, 2)), "drive must be uint8 of the shape"),
    "drive": (np.zeros((3, 2, 3), dtype=np.uint8), "drive must be indices among velocities"),
    "control_period": (0.0, "control_period must be"),
    "view": ((0, 0, 0, 1), "view must enclose an area"),
    "obeys": (np.ones((1, 1), dtype=bool), "obeys must have rotor's shape"),
    "contacts": (np.zeros((1, 4)), "first_contact must say"),
    "first_contact": (np.array([0, 1, 2, 3]), "first_contact must rise"),
    "bearer": (np.zeros(2, dtype=np.int64), "bearer must have a parcel for each of 0 contacts"),
    "pushes": (np.ones((1, 6)), "pushes must be of the 1 parcels"),
    "first_push": (np.array([0, 1, 1, 1]), "first_push must rise from 0 to the number of pushes"),
    "delivered": (np.zeros((3, 2)), "delivered must have a row a frame"),
    "metrics": ({"reward": np.zeros(2)}, r"metrics\['reward'\] must have 3 rows"),
    "outcome": (3, "outcome must be a text"),
    "parcels": (
        (RecordedParcel(BOX.base.outline, 2, np.zeros((2, 3)), np.zeros((2, 3))),),
        r"parcels\[0\] must be within the 3 frames",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_gets_an_error_that_names_it(name):
    value, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        recording(**{name: value})


def test_bad_marks_and_parcels_get_an_error_that_names_it():
    with pytest.raises(ValueError, match="kind must be one of"):
        Mark("box", np.zeros((2, 2)))
    with pytest.raises(ValueError, match="points must be at least 2"):
        Mark("line", np.zeros((1, 2)))
    with pytest.raises(ValueError, match="pose"):
        RecordedParcel(BOX.base.outline, 0, np.full((1, 3), np.nan), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="env must be an environment of a surface"):
        RecordReplay(gym.make("CartPole-v1"))


def damaged(found):
    packed = recording().encode()
    content = zlib.decompress(packed)
    return {
        "empty": b"",
        "text": b"no recording",
        "cut": packed[:-9],
        "short": zlib.compress(content[:-1]),
        "long": zlib.compress(content + b"0"),
        "other": zlib.compress(content.replace(b"surface_gym recording", b"surface_gym regording")),
        "large": zlib.compress(content.replace(b'"frames":3', b'"frames":9')),
        "claim": zlib.compress(content.replace(b'"exits":0', b'"exits":2147483648')),
        "bomb": zlib.compress(content + bytes(2**25)),
        "header": zlib.compress(b"\xff" * 100),
        "newer": zlib.compress(content.replace(b'"version":2', b'"version":7')),
    }[found]


@pytest.mark.parametrize(
    "found",
    ["empty", "text", "cut", "short", "long", "other", "large", "claim", "bomb", "header", "newer"],
)
def test_a_damaged_file_is_an_error_that_names_it(tmp_path, found):
    file = tmp_path / "bad.replay"
    file.write_bytes(damaged(found))
    with pytest.raises(ValueError, match=r"path must lead to a recording.*bad\.replay"):
        Recording.load(file)


def test_no_more_of_a_bomb_is_unpacked_than_its_header_claims():
    whole = zlib.decompress(recording().encode())
    packer = zlib.compressobj()
    zeros = (packer.compress(b"\0" * 2**20) for _ in range(100))
    bomb = b"".join([packer.compress(whole), *zeros, packer.flush()])
    tracemalloc.start()
    with pytest.raises(ValueError, match="it must end, got more bytes"):
        Recording.decode(bomb)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2**22
    with pytest.raises(ValueError, match="exits must be a whole number of at most"):
        Recording.decode(zlib.compress(whole.replace(b'"exits":0', b'"exits":9')))


def test_a_path_must_be_of_a_recording(tmp_path):
    with pytest.raises(ValueError, match=r"path must end in \.replay"):
        recording().save(tmp_path / "run.npz")
    with pytest.raises(FileNotFoundError):
        Recording.load(tmp_path / "none.replay")
