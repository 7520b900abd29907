"""The search, held against costs whose least is known."""

import math

import numpy as np
import pytest

from surface_gym.design.search import Effort, LayoutSpace, search

ORIENTATIONS = tuple(np.radians([-45.0, 0.0, 45.0, 90.0]).tolist())
SMALL = Effort(members=16, generations=5, epochs=4, rounds=2)
ROLLING = np.full((1, 2, 5), math.pi / 2)
SPACE = LayoutSpace(2, 5, ORIENTATIONS)


def target(space: LayoutSpace = SPACE) -> np.ndarray:
    """A layout (rows, columns) [rad] drawn by chance."""
    return space.axes(space.sample(np.random.default_rng(5), 1))[0]


def apart(wanted: np.ndarray):
    """A cost that is least, 0, at the wanted axes; its slope tells little: modules that differ."""

    def score(axes: np.ndarray) -> np.ndarray:
        return np.abs(np.sin(axes - wanted)).sum(axis=(1, 2))

    return score


def test_it_finds_the_least_of_a_sum_over_modules_and_keeps_what_it_begins_with():
    found, _ = search(SPACE, apart(target()), ROLLING, SMALL, seed=0)
    np.testing.assert_array_equal(found, target())
    found, compared = search(SPACE, apart(target()), target()[None], Effort(5, 1, 1, 0), seed=3)
    np.testing.assert_array_equal(found, target())
    assert compared == 5 + 5  # the population and one generation


def test_it_finds_what_no_single_module_tells_by_all_of_a_column():
    def score(axes: np.ndarray) -> np.ndarray:
        right = (np.abs(axes - target()) < 1e-9).all(axis=1)
        return -right.sum(axis=1).astype(float)

    found, _ = search(SPACE, score, ROLLING, Effort(5, 1, 0, 1), seed=0)
    np.testing.assert_array_equal(found, target())


def test_any_angle_may_be_found():
    space = LayoutSpace(2, 3, None)
    wanted = np.radians([[10.0, -20.0, 33.0], [5.0, 80.0, -61.0]])
    effort = Effort(members=30, generations=40, epochs=5, rounds=10)
    found, _ = search(space, apart(wanted), ROLLING[:, :, :3], effort, seed=0)
    assert np.abs(np.sin(found - wanted)).max() < math.radians(2.0)


class Broken(Exception):
    """Raised where a search is broken off."""


@pytest.mark.parametrize("orientations", [ORIENTATIONS, None], ids=["some", "any"])
@pytest.mark.parametrize("after", [1, 3, 5, 8])
def test_interrupted_and_resumed_it_finds_the_same_to_the_bit(orientations, after, tmp_path):
    space = LayoutSpace(2, 5, orientations)
    rough = np.random.default_rng(1).normal(size=(2, 5))

    def score(axes: np.ndarray) -> np.ndarray:
        return np.cos(7.0 * axes * rough).sum(axis=(1, 2)) + np.sin(axes.sum(axis=(1, 2)))

    whole, compared = search(space, score, ROLLING, SMALL, 0)
    steps = []

    def stop(done: int, _: int) -> None:
        steps.append(done)
        if len(steps) == after:
            raise Broken

    file = tmp_path / "search.npz"
    with pytest.raises(Broken):
        search(space, score, ROLLING, SMALL, 0, file, on_progress=stop)
    assert file.exists() == (after > 1)
    found, again = search(space, score, ROLLING, SMALL, 0, file)
    np.testing.assert_array_equal(found, whole)
    assert again == compared
    assert [path.name for path in tmp_path.iterdir()] == ["search.npz"]


def test_the_seed_alone_is_left_to_chance_and_progress_is_reported():
    space = LayoutSpace(2, 5, None)
    score, effort = apart(target(space)), Effort(8, 2, 2, 0)
    one, same, other = (search(space, score, ROLLING, effort, seed)[0] for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    calls = []
    search(SPACE, apart(target()), ROLLING, SMALL, 0, on_progress=lambda *at: calls.append(at))
    done = [at for at, _ in calls]
    assert done == sorted(done)
    assert {steps for _, steps in calls} == {4 + 2 * 5}
    assert (done[0], done[-1]) == (0, 14)


def test_the_checkpoint_of_another_search_or_none_is_refused(tmp_path):
    file = tmp_path / "search.npz"
    search(SPACE, apart(target()), ROLLING, SMALL, 0, file, {"name": "one"})
    for seed, name in ((0, "another"), (1, "one")):
        with pytest.raises(ValueError, match="checkpoint must be of this search"):
            search(SPACE, apart(target()), ROLLING, SMALL, seed, file, {"name": name})
    for content in (b"", b"no archive", b"PK\x03\x04 cut off"):
        file.write_bytes(content)
        with pytest.raises(ValueError, match="checkpoint must be one of a search"):
            search(SPACE, apart(target()), ROLLING, SMALL, 0, file)


def test_members_and_axes_are_each_other_s_inverse_but_for_a_turn_by_pi():
    for orientations in (ORIENTATIONS, None):
        space = LayoutSpace(3, 4, orientations)
        axes = space.axes(space.sample(np.random.default_rng(0), 20))
        np.testing.assert_array_equal(space.axes(space.members(axes)), axes)
    axes = np.radians([[[135.0, -90.0, 180.0]]])
    places = LayoutSpace(1, 3, ORIENTATIONS).members(axes)
    np.testing.assert_array_equal(places, [[0.0, 3.0, 1.0]])
    angles = LayoutSpace(1, 3, None).members(axes)[0, [0, 2]]
    np.testing.assert_allclose(angles, [-math.pi / 4, 0.0], atol=1e-12)


@pytest.mark.parametrize(("rows", "count"), [(2, 16), (4, 256), (5, 20)])
def test_neighbours_differ_in_one_column(rows, count):
    """All arrangements of it, or single modules where these are too many."""
    space = LayoutSpace(rows, 3, ORIENTATIONS)
    member = space.sample(np.random.default_rng(2), 1)[0]
    around = space.neighbours(member, 1).reshape(count, rows, 3)
    differs = around != member.reshape(rows, 3)
    assert not differs[:, :, [0, 2]].any()
    if rows < 5:
        assert len(np.unique(around, axis=0)) == 4**rows
    else:
        assert (differs.sum(axis=(1, 2)) <= 1).all()


def test_an_effort_that_is_none_is_refused():
    for name, value in (("members", 4), ("generations", 0), ("epochs", -1), ("rounds", 1.5)):
        with pytest.raises(ValueError, match=name):
            Effort(**{name: value})
