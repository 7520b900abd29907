"""Pictures as observations, against what the environments say of themselves in numbers."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_by_gymnasium
from stable_baselines3.common.env_checker import check_env as check_by_stable_baselines3

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.extend import Canvas, EnvState, draw_line, kernel_function
from surface_gym.lines import Field
from surface_gym.tasks.start import Start
from tests import environments as te
from tests.test_vector_env import run_beside

COLOURS = sg.Image(height=80, width=120, channels=3)
RED, GREEN, BLUE = range(3)
HALVES = te.cell(te.SORT, "halves")
# An environment of each task, whose kernel other tests compile too.
CELLS = {env_id: next(each for each in te.CELLS_BY_DAY if each[0] == env_id) for env_id in te.IDS}


def settings(env_id: str) -> dict[str, Any]:
    _, actions, sensor = CELLS[env_id]
    return {"actions": actions, "sensors": sensor()}


class View:
    """Where the pixels of a picture of the whole surface are."""

    def __init__(self, env: sg.SmartSurfaceEnv) -> None:
        (self.height, self.width, _), line = env.observation_space.shape, env.config.chosen_line
        left, right, low, high = line.extent
        self.pixel = max((right - left) / self.width, (high - low) / self.height)  # [m]
        self.x = 0.5 * (left + right) + self.pixel * (np.arange(self.width) + 0.5 - self.width / 2)
        up = self.pixel * (self.height / 2 - 0.5 - np.arange(self.height))
        self.y = 0.5 * (low + high) + up

    def points(self, fine: int) -> tuple[np.ndarray, np.ndarray]:
        """x and y [m] of `fine` x `fine` points in every pixel."""
        off = self.pixel * ((np.arange(fine) + 0.5) / fine - 0.5)
        return np.meshgrid(np.ravel(self.x[:, None] + off), np.ravel(self.y[:, None] - off))

    def mean(self, weights: np.ndarray) -> tuple[float, float]:
        """x and y [m] of the centroid of weights (height, width)."""
        total = weights.sum()
        return float(weights.sum(axis=0) @ self.x / total), float(
            weights.sum(axis=1) @ self.y / total
        )


def plain_sort(parcel: sg.Parcel, pose: tuple[float, float, float]) -> Start:
    return Start(parcel, pose, (0.8, 0.0, 0.0), (1.0,))


@pytest.mark.parametrize("name", te.PARCELS)
def test_a_parcel_covers_the_pixels_that_its_base_covers(name):
    """Shape, place and heading: the blue of a pixel is the share of it that is in the base."""
    parcel, fine = te.PARCELS[name], 8
    env = te.bare(observe=COLOURS, **HALVES)
    env.reset(seed=0)
    view = View(env)
    for x, y, theta in [(1.3, 0.97, 0.4), (0.83, 1.21, -2.1), (2.0, 1.0, 0.0)]:
        te.put(env.batch, plain_sort(parcel, (x, y, theta)))
        blue = env.batch.observation[0, ..., BLUE] / 255.0
        pose, centre = env.batch.info(0)["pose"], parcel.base.centroid
        inside = te.outside(parcel.base, pose, *view.points(fine), about=centre) <= 0.0
        share = inside.reshape(view.height, fine, view.width, fine).mean(axis=(1, 3))
        assert np.abs(blue - share).max() < 0.08
        assert blue.sum() == pytest.approx(share.sum(), rel=0.01)
        assert view.mean(blue) == pytest.approx(tuple(pose[:2]), abs=0.02 * view.pixel)


def test_its_spread_is_that_of_its_heading_and_a_line_points_to_its_front():
    env = te.bare(observe=COLOURS, **HALVES)
    env.reset(seed=0)
    view = View(env)
    length, width, pose = 0.5, 0.3, (1.5, 1.1, 2.5)
    te.put(env.batch, plain_sort(sg.Parcel(sg.Rectangle(length, width)), pose))
    picture = env.batch.observation[0] / 255.0
    blue = picture[..., BLUE]
    x, y = view.mean(blue)
    dx, dy = view.x - x, (view.y - y)[:, np.newaxis]
    products = [(blue * each).sum() / blue.sum() for each in (dx * dx, dx * dy, dy * dy)]
    spread, axes = np.linalg.eigh([[products[0], products[1]], [products[1], products[2]]])
    assert spread == pytest.approx([width**2 / 12.0, length**2 / 12.0], rel=0.03)
    assert abs(axes[:, 1] @ [math.cos(pose[2]), math.sin(pose[2])]) > 0.9999
    front = view.mean(blue - np.minimum(blue, picture[..., RED]))
    ahead = math.atan2(front[1] - y, front[0] - x)
    assert abs(ahead - pose[2]) < 0.02


def shown_axes(picture: np.ndarray, view: View, env: sg.SmartSurfaceEnv) -> Iterator[Any]:
    """Row, column and the pixel in the middle of every rotor that neither parcel nor goal hides."""
    state, line = env.batch.view(0), env.config.chosen_line
    for row, column in np.argwhere(state.rotor).tolist():
        x, y = line.origin[0] + line.pitch_x * column, line.origin[1] + line.pitch_y * row
        pixel = picture[np.abs(view.y - y).argmin(), np.abs(view.x - x).argmin()] / 255.0
        away = math.hypot(x - state.truth[0], y - state.truth[1]) > 0.5
        if away and pixel[BLUE] == 0.0:
            yield row, column, pixel


def test_modules_have_the_colour_of_their_axes_as_they_turn():
    image = sg.Image(height=200, width=300, channels=3)
    env = te.bare(
        observe=image, info=("axes",), actions="quadrants", actuators=sg.Actuators(axis_speed=8.0)
    )
    env.reset(seed=1, options={"speed": 1.0})
    view, seen = View(env), set()
    for action in ([1, 2, 0, 3], [2, 0, 1, 1], [0, 1, 3, 2]):
        picture, _, _, _, info = env.step(action)
        for row, column, pixel in shown_axes(picture, view, env):
            twice = math.atan2(pixel[GREEN] - 0.4, pixel[RED] - 0.4)
            apart = math.remainder(twice - 2.0 * info["axes"][row, column], 2.0 * math.pi)
            assert abs(apart) < 0.03
            seen.add(round(float(info["axes"][row, column]), 2))
    assert len(seen) > 3  # on their way, too


def test_driven_modules_have_the_colour_of_their_velocity():
    env = te.bare(observe=sg.Image(200, 300, 3), actions="halves", modules="omni")
    env.reset(seed=1)
    view = View(env)
    for action in (0, 10, 37):
        picture = env.step(action)[0]
        velocity = env.batch.surface_velocity(0)
        for row, column, pixel in shown_axes(picture, view, env):
            shown = (pixel[[RED, GREEN]] - 0.4) / 0.35 * 2.0
            np.testing.assert_allclose(shown, velocity[row, column], atol=0.03)


def test_a_pixel_is_the_mean_of_the_elements_under_it():
    """Where neither parcel nor goal is; pixels are larger than elements."""
    fine, steps = 40, 255.0 * np.array([[0.1, 0.1, 0.0], [0.05, 0.4, 0.0]])
    env = te.bare(observe=sg.Image(10, 15, 3), **HALVES)
    picture, _ = env.reset(seed=0, options={"side": 0, "parcel": "S"})
    view, line = View(env), env.config.chosen_line
    x, y = view.points(fine)
    column, row = np.floor(x / line.pitch_x).astype(int), np.floor(y / line.pitch_y).astype(int)
    under = steps[env.batch.view(0).rotor[row, column].astype(int)]
    mean = under.reshape(view.height, fine, view.width, fine, 3).mean(axis=(1, 3))
    free = (view.x > 0.6) & (view.x < 1.5)
    np.testing.assert_allclose(picture[:, free], mean[:, free], atol=2.5)
    assert (picture[:, free].max(axis=(0, 1)) > [20, 60, -1]).all()


def goal_pixels(picture: np.ndarray) -> np.ndarray:
    """Shares (height, width) of pixels that are of the goal alone."""
    red = picture[..., RED] / 255.0
    return np.where((picture[..., BLUE] == 0) & (red > 0.5), red, 0.0)


def aim_of_sort(view: View, goal: np.ndarray, options: dict[str, Any]) -> None:
    _, y = view.mean(goal)
    assert (y - 1.0) * options["side"] == pytest.approx(0.2 + 0.05, abs=view.pixel)


def aim_of_stop(view: View, goal: np.ndarray, options: dict[str, Any]) -> None:
    x, _ = view.mean(goal)
    assert x == pytest.approx(options["position"], abs=0.5 * view.pixel)


def aim_of_orient(view: View, goal: np.ndarray, options: dict[str, Any]) -> None:
    x, y = view.mean(goal)
    end = 2.1, 1.0
    assert math.atan2(y - end[1], x - end[0]) == pytest.approx(options["angle"], abs=0.05)


def aim_of_park(view: View, goal: np.ndarray, options: dict[str, Any]) -> None:
    """A line as long as the B-box, 0.45 m, into the goal; the entry is at (0.4, 0.8) m."""
    x, y = view.mean(goal)
    end = 0.4 + options["ahead"], 0.8 + options["aside"]
    assert math.atan2(end[1] - y, end[0] - x) == pytest.approx(options["angle"], abs=0.05)
    assert math.dist(end, (x, y)) == pytest.approx(0.5 * 0.45, abs=view.pixel)


def aim_of_slow(view: View, goal: np.ndarray, options: dict[str, Any]) -> None:
    tall = view.pixel * (goal.max(axis=1) > 0.0).sum()
    asked = options["ratio"] * options["speed"]
    assert tall == pytest.approx(0.4 * asked, abs=1.5 * view.pixel)


def aim_of_track(view: View, goal: np.ndarray, options: dict[str, Any]) -> None:
    points = np.array(options["path"])
    for k in np.nonzero((view.x > 1.0) & (view.x < 3.8))[0]:
        column = goal[:, k]
        y = column @ view.y / column.sum()
        assert y == pytest.approx(np.interp(view.x[k], *points.T), abs=view.pixel)


AIMS: dict[str, Callable[[View, np.ndarray, dict[str, Any]], None]] = {
    te.SORT: aim_of_sort, "SmartSurface/Stop-v0": aim_of_stop, "SmartSurface/Slow-v0": aim_of_slow,
    "SmartSurface/Orient-v0": aim_of_orient, "SmartSurface/Track-v0": aim_of_track,
    "SmartSurface/Park-v0": aim_of_park,
}  # fmt: skip


@te.every_id
def test_the_goal_is_where_the_options_say(env_id):
    env = te.bare(env_id, observe=sg.Image(160, 240, 3), **settings(env_id))
    picture, _ = env.reset(seed=0, options=te.OPTIONS[env_id])
    goal = goal_pixels(picture)
    assert goal.sum() > 4.0
    AIMS[env_id](View(env), goal, te.OPTIONS[env_id])


def test_a_mirrored_scene_has_the_mirrored_picture():
    """Of modules, red; green has the sine of their angle."""
    env = te.bare(observe=COLOURS, **HALVES)
    pictures = []
    for side in (1, -1):
        env.reset(seed=0, options={"speed": 1.1, "parcel": "S", "side": side})
        shown = []
        for ahead, behind in [(3, 3), (3, 3), (2, 3), (1, 2), (2, 2), (2, 2), (2, 2)]:
            mirrored = {1: 2, 2: 1} if side < 0 else {}
            action = 4 * mirrored.get(ahead, ahead) + mirrored.get(behind, behind)
            shown.append(env.step(action)[0][..., [RED, BLUE]].astype(int))
        pictures.append(np.array(shown))
    assert np.abs(pictures[0][:, ::-1] - pictures[1]).max() <= 1
    assert np.abs(pictures[0] - pictures[1]).max() > 200  # it is led aside


def test_grey_is_the_luminance_of_the_colours():
    grey, colours = (
        te.bare(observe=sg.Image(40, 60, channels), **HALVES).reset(seed=2)[0]
        for channels in (1, 3)
    )
    assert grey.shape == (40, 60, 1)
    expected = colours @ np.array([0.299, 0.587, 0.114])
    assert np.abs(grey[..., 0] - expected).max() <= 2.0


def test_an_area_is_shown_as_large_as_it_fits():
    """Half of the surface's length in as many pixels: a parcel covers four times as many."""
    covered = []
    for area in (None, (0.0, 1.5, 0.5, 1.5)):
        env = te.bare(observe=sg.Image(80, 120, 3, area), **HALVES)
        picture, _ = env.reset(seed=0, options={"parcel": "B"})
        covered.append(picture[..., BLUE].sum() / 255.0)
    assert covered[1] == pytest.approx(4.0 * covered[0], rel=0.01)
    assert covered[0] == pytest.approx((0.45 * 120 / 3.0) ** 2, rel=0.01)


class TestSame:
    @te.every_mode
    def test_a_vector_of_environments_shows_what_single_ones_do(self, mode):
        """Pictures at the end of an episode, too."""
        common = {"observe": "image", **HALVES}
        singles = te.singles(te.SORT, mode, **common)
        native = te.native(max_episode_steps=te.LIMIT, autoreset_mode=mode, **common)
        assert run_beside(native, singles, mode, 3 * te.LIMIT) > 3

    def test_neither_threads_nor_other_environments_matter(self):
        few = te.native(num_envs=2, observe="image", **HALVES)
        many = te.native(num_envs=16, threads=2, observe="image", **HALVES)
        te.assert_same(few.reset(seed=4)[0], many.reset(seed=4)[0][:2])
        rng = np.random.default_rng(0)
        for _ in range(40):
            actions = rng.integers(0, 16, 16)
            te.assert_same(few.step(actions[:2])[0], many.step(actions)[0][:2])

    @te.every_id
    def test_only_the_observation_differs_from_that_of_features(self, env_id):
        plain = te.bare(env_id, **settings(env_id))
        seeing = te.bare(env_id, observe="image", **settings(env_id))
        for (_, *one), (picture, *other) in zip(
            te.steps(plain, seed=5, longest=20), te.steps(seeing, seed=5, longest=20), strict=True
        ):
            te.assert_same(tuple(one), tuple(other))
            assert picture in seeing.observation_space

    def test_a_seed_is_a_picture(self):
        env, twin = te.pair(observe="image", **HALVES)
        first = env.reset(seed=3)[0]
        te.assert_same(first, twin.reset(seed=3)[0])
        assert (first != env.reset(seed=4)[0]).any()
        env.step(3)
        te.assert_same(first, env.reset(seed=3)[0])

    def test_an_observation_stays_as_it_was(self):
        for env in (te.bare(observe="image", **HALVES), te.native(observe="image", **HALVES)):
            first, _ = env.reset(seed=3)
            kept = first.copy()
            second = env.step(env.action_space.sample())[0]
            te.assert_same(first, kept)
            assert (first != second).any()

    @pytest.mark.parametrize("copied", te.TWINS, ids=["pickle", "deepcopy"])
    def test_a_copied_environment_goes_on_alike(self, copied):
        env = te.bare(observe="image", **HALVES)
        env.reset(seed=3)
        twin = copied(env)
        te.assert_same(env.step(6)[0], twin.step(6)[0])

    def test_a_restored_state_has_its_picture(self):
        env = te.bare(observe="image", **HALVES)
        before, _ = env.reset(seed=3)
        state = env.batch.snapshot()
        env.step(10)
        env.batch.restore(state)
        te.assert_same(env.batch.observation[0].copy(), before)


def test_the_pose_is_the_true_one_whatever_the_sensors_report():
    env = te.bare(observe=COLOURS, actions="halves", sensors=sg.sensors.Presence())
    env.reset(seed=0)
    view = View(env)
    for _ in range(5):
        picture, *_, info = env.step(15)
        place = view.mean(picture[..., BLUE] / 255.0)
        assert place == pytest.approx(tuple(info["pose"][:2]), abs=0.05 * view.pixel)
    assert np.abs(env.batch.view(0).sensed[:2] - info["pose"][:2]).max() > 0.001


@te.every_id
def test_the_checkers_have_nothing_to_say(env_id):
    env = te.bare(env_id, observe="image", **settings(env_id))
    assert env.observation_space == gym.spaces.Box(0, 255, (64, 64, 1), np.uint8)
    check_by_gymnasium(env, skip_render_check=True)
    check_by_stable_baselines3(env)


def test_frames_are_stacked_by_gymnasium():
    env = gym.wrappers.FrameStackObservation(te.bare(observe="image", **HALVES), 3)
    frames, _ = env.reset(seed=0)
    assert frames.shape == (3, 64, 64, 1)
    assert (env.step(15)[0][-1] != frames[-1]).any()


def draw_without_an_end(state: EnvState, canvas: Canvas) -> None:
    draw_line(canvas, (0.0, state.goal[0]))


def draw_beyond(state: EnvState, canvas: Canvas) -> None:
    draw_line(canvas, (0.0, state.goal[1]), (1.0, 1.0), 0.1)


class TestBadInput:
    @pytest.mark.parametrize(
        ("given", "message"),
        [
            (
                {"observe": "picture"},
                "observe must be 'image', an Image, or some of .*, got 'picture'",
            ),
            ({"observe": ("image", "parcel")}, "observe must have no groups beside an image, got"),
            ({"observe": (sg.Image(),)}, "observe must have no groups beside an image, got"),
            ({"observe": sg.Image}, r"observe must be 'image', an .*; call it: Image\(\)"),
            (
                {"observe": "image", "observe_axes": True},
                "observe_axes must be False with an image",
            ),
            (
                {"task": "track", "observe": "image", "line": Field(4, 5000)},
                "line must have at most 4096 rows and columns for an image, got 4 and 5000",
            ),
            ({"task": "flow", "observe": "image"}, r"observe must be \(\) for a stream"),
        ],
    )
    def test_it_is_named(self, given, message):
        with pytest.raises(ValueError, match=f"^{message}"):
            EnvConfig(**given)

    def test_pictures_are_not_decoded(self):
        config = EnvConfig(observe="image")
        with pytest.raises(ValueError, match=r"^observe must be of features to be decoded, got I"):
            config.decode(np.zeros((1, 64, 64, 1)))

    @pytest.mark.parametrize(
        ("function", "message"),
        [
            (print, "must be a static method and a kernel_function"),
            (kernel_function(draw_without_an_end), "does not compile"),
            (kernel_function(draw_beyond), "must keep within its arrays"),
        ],
    )
    def test_a_task_that_draws_wrongly_is_named(self, function, message):
        class Sort(sg.tasks.Sort):  # by its name, its other code is compiled already
            draw_goal = staticmethod(function)

        with pytest.raises(ValueError, match=rf"^Sort\.draw_goal {message}"):
            sg.SmartSurfaceEnv(Sort(), observe="image", **HALVES).reset(seed=0)
