"""What modules see, against where the parcel truly is."""

import numpy as np
import pytest

import surface_gym as sg
from agents.modules.view import ModuleView
from surface_gym.layouts import LEAD_IN, LINE_ROWS, LINE_Y
from surface_gym.settings import Settings
from tests.environments import PITCH

LANES = 40
HALF_LENGTH = {"S": 0.125, "B": 0.225}


def on_the_way(parcel: str, side: int, zone: tuple[int, int] | None = None, seed: int = 0):
    """Lanes some control periods after their starts, with axes at random."""
    env = sg.SmartSurfaceVectorEnv(LANES, zone=zone)
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0.8, 2.5, LANES)
    starts = [{"speed": float(v), "parcel": parcel, "side": side} for v in speed]
    observation, info = env.reset(seed=0, options=starts)
    view = ModuleView(env.settings)
    mirror = np.arange(4) if side > 0 else np.array([0, 2, 1, 3])
    rows, columns = view._settings.action_kind.shape
    for _ in range(6):
        actions = rng.choice(4, p=[0.05, 0.25, 0.6, 0.1], size=(LANES, rows, columns))
        if side < 0:
            actions = mirror[actions][:, ::-1]
        observation, _, _, _, info = env.step(actions.reshape(LANES, -1))
    return view, observation, info["pose"]


def under(pose: np.ndarray, parcel: str, zone: tuple[int, int]) -> list[set[tuple[int, int]]]:
    """Rotors (row, column) of the zone whose centres lie under the base, lane by lane."""
    first_row = 10 - LINE_ROWS[parcel] // 2
    found = []
    for x, y, theta in pose:
        turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
        found.append(
            {
                (row, column)
                for row in range(first_row, first_row + LINE_ROWS[parcel])
                for column in range(zone[0], zone[1] + 1)
                if np.abs(turn @ (PITCH * np.array([column + 0.5, row + 0.5]) - (x, y))).max()
                <= HALF_LENGTH[parcel]
            }
        )
    return found


@pytest.mark.parametrize("zone", [None, (3, 29), (6, 12)])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("parcel", ["S", "B"])
def test_every_module_under_the_parcel_is_seen(
    parcel: str, side: int, zone: tuple[int, int] | None
) -> None:
    view, observation, pose = on_the_way(parcel, side, zone)
    first, last = zone or (LEAD_IN[parcel], LEAD_IN[parcel] + 15)
    seen = view(observation)
    row, column = np.divmod(seen.number, last - first + 1)
    covered = seen.place[:, 4] == 1.0
    bearing = under(pose, parcel, (first, last))
    assert sum(map(len, bearing)) > 50
    for lane in range(LANES):
        of_lane = (seen.lane == lane) & covered
        places = zip(row[of_lane] + 8, column[of_lane] + first, strict=True)
        assert set(places) == bearing[lane]
    # Where each is, in half lengths along and across the parcel.
    x, y, theta = pose[seen.lane].T
    dx, dy = PITCH * (column + first + 0.5) - x, PITCH * (row + 8.5) - y
    along = (np.cos(theta) * dx + np.sin(theta) * dy) / HALF_LENGTH[parcel]
    across = side * (np.cos(theta) * dy - np.sin(theta) * dx) / HALF_LENGTH[parcel]
    np.testing.assert_allclose(seen.place[:, :2], np.stack([along, across], -1), atol=2e-5)
    # And along and across the line: from the parcel in 0.3 m, from the line's middle in 0.15 m.
    beside = np.stack([dx / 0.3, side * dy / 0.3, side * (dy + y - LINE_Y) / 0.15], -1)
    np.testing.assert_allclose(seen.place[:, 6:], beside, atol=2e-5)


def test_those_that_will_be_under_are_seen() -> None:
    """After a period at 90 deg a rolling parcel lies on modules that were seen before."""
    env = sg.SmartSurfaceVectorEnv(LANES)
    starts = [{"speed": 2.7, "parcel": "S", "side": 1}] * LANES
    observation, _ = env.reset(seed=0, options=starts)
    view = ModuleView(env.settings)
    before = view(observation)
    for _ in range(6):
        observation, *_ = env.step(np.full((LANES, 64), 3))
        after = view(observation)
        assert set(after.number[after.place[:, 4] == 1.0]) <= set(before.number)
        before = after
    assert len(after.number) > 0


@pytest.mark.parametrize("parcel", ["S", "B"])
def test_the_other_side_is_the_mirror_image(parcel: str) -> None:
    view, left, pose = on_the_way(parcel, 1)
    _, right, other = on_the_way(parcel, -1)
    np.testing.assert_allclose(other[:, 1] - LINE_Y, LINE_Y - pose[:, 1], atol=1e-9)
    one, two = view(left), view(right)
    order = np.lexsort((one.place[:, 7], one.place[:, 6].round(3), one.lane))
    image = np.lexsort((two.place[:, 7], two.place[:, 6].round(3), two.lane))
    np.testing.assert_allclose(two.place[image], one.place[order], atol=1e-4)
    np.testing.assert_allclose(two.shared, one.shared, atol=1e-4)
    rng = np.random.default_rng(1)
    choices = rng.integers(4, size=len(order))
    towards, away = np.empty_like(choices), np.empty_like(choices)
    towards[order], away[image] = choices, choices
    actions = view.actions(left, one, towards).reshape(LANES, 4, 16)
    mirrored = view.actions(right, two, away).reshape(LANES, 4, 16)
    np.testing.assert_array_equal(mirrored, np.array([0, 2, 1, 3])[actions[:, ::-1]])


def test_modules_away_from_the_parcel_stay_at_90_deg() -> None:
    view, observation, _ = on_the_way("B", 1)
    seen = view(observation)
    actions = view.actions(observation, seen, np.zeros(len(seen.number), dtype=np.int64))
    assert (actions == 0).sum() == len(seen.number)
    assert (actions == 3).sum() == actions.size - len(seen.number)


def test_other_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="task must be one of 'sort'"):
        ModuleView(Settings(task="slow", actions="modules"))
    with pytest.raises(ValueError, match="actions must be one of 'modules'"):
        ModuleView(Settings(actions="halves"))
