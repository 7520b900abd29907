"""Observations of modules, against the true parcel, and outlines, against the base itself."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents import module_places, module_policy
from surface_gym.agents.module_places import Outline, find_shown
from surface_gym.agents.rules import decoding
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.layouts import LEAD_IN, LINE_Y, ROWS, lead_in_under, rows_under
from surface_gym.lines import Pattern
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.randomisation import Actuators, Randomisation
from tests.environments import PITCH, outside

NUM_ENVS = 40
# Compiled as Python calls them.
see_line = compiled(decoding.see_line.py_func)
count_rows, find_reach, find_outline = (
    compiled(getattr(module_places, name).py_func)
    for name in ("count_rows", "find_reach", "find_outline")
)


def on_the_way(parcel: str, side: int, zone: tuple[int, int] | None = None):
    """Environments some control periods after their starts, with random axes."""
    env = sg.SmartSurfaceVectorEnv(NUM_ENVS, zone=zone)
    rng = np.random.default_rng(0)
    speed = rng.uniform(0.8, 2.5, NUM_ENVS)
    starts = [{"speed": float(v), "parcel": parcel, "side": side} for v in speed]
    observation, info = env.reset(seed=0, options=starts)
    view = module_policy.SortModuleView(env.config)
    mirror = np.arange(4) if side > 0 else np.array([0, 2, 1, 3])
    rows, columns = env.config.action_kind.shape
    for _ in range(6):
        actions = rng.choice(4, p=[0.05, 0.25, 0.6, 0.1], size=(NUM_ENVS, rows, columns))
        if side < 0:
            actions = mirror[actions][:, ::-1]
        observation, _, _, _, info = env.step(actions.reshape(NUM_ENVS, -1))
    return view, observation, info["pose"]


@pytest.mark.parametrize("zone", [None, (6, 12)])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("parcel", ["S", "B"])
def test_every_module_under_the_parcel_is_seen(parcel, side, zone) -> None:
    view, observation, pose = on_the_way(parcel, side, zone)
    first, last = zone or (LEAD_IN[parcel], LEAD_IN[parcel] + 15)
    seen, base = view(observation), sg.layouts.box(parcel).base
    row, column = np.divmod(seen.index, last - first + 1)
    covered, total = seen.place[:, 4] == 1.0, 0
    for i in range(NUM_ENVS):
        of_env = (seen.env == i) & covered
        places = set(zip(row[of_env] + 8, column[of_env] + first, strict=True))
        assert places == under_base(base, pose[i], first, last)
        total += len(places)
    assert total > 50
    # Where each is, in half lengths along and across the parcel.
    x, y, theta = pose[seen.env].T
    dx, dy = PITCH * (column + first + 0.5) - x, PITCH * (row + 8.5) - y
    along, across = np.cos(theta) * dx + np.sin(theta) * dy, np.cos(theta) * dy - np.sin(theta) * dx
    half_length = np.ptp(base.outline[:, 0]) / 2.0
    place = np.stack([along, side * across], -1) / half_length
    np.testing.assert_allclose(seen.place[:, :2], place, atol=2e-5)
    # And along and across the line: from the parcel in 0.3 m, from the line's middle in 0.15 m.
    beside = np.stack([dx / 0.3, side * dy / 0.3, side * (dy + y - LINE_Y) / 0.15], -1)
    np.testing.assert_allclose(seen.place[:, 6:], beside, atol=2e-5)


RECTANGLES = (
    Rectangle(0.4, 0.25), Rectangle(0.37, 0.27), Rectangle(0.25, 0.4), Rectangle(0.35, 0.2),
    Rectangle(0.22, 0.34), Rectangle(0.2, 0.39), Rectangle(0.45, 0.399), Rectangle(0.3, 0.55),
)  # fmt: skip
# Of both kinds of line, and what may be taken for a square of another width.
BASES = (*RECTANGLES[:5], Disc(0.15), Disc(0.22))


@pytest.mark.parametrize("observe", [(), ("parcel",)], ids=["guessed", "shown"])
@pytest.mark.parametrize("side", [1, -1])
def test_every_module_under_a_base_of_any_shape_is_seen(side, observe) -> None:
    bases = [base for base in BASES for _ in range(8)]
    env = sg.SmartSurfaceVectorEnv(len(bases), observe=observe)
    starts = [{"speed": 2.5, "parcel": Parcel(base), "side": side} for base in bases]
    rng = np.random.default_rng(0)
    seen, info = env.reset(seed=0, options=starts)
    for _ in range(7):
        # Rows that differ turn the parcel.
        rows = rng.choice(4, p=[0.1, 0.2, 0.2, 0.5], size=(len(bases), 4, 1))
        seen, _, _, _, info = env.step(np.tile(rows, 16).reshape(len(bases), -1))
    assert np.ptp(info["pose"][:, 2]) > 0.1
    modules, total = module_policy.SortModuleView(env.config)(seen), 0
    row, column = np.divmod(modules.index, 16)
    for i, base in enumerate(bases):
        of_env = (modules.env == i) & (modules.place[:, 4] == 1.0)
        first = lead_in_under(np.ptp(base.outline[:, 0]), PITCH)
        places = set(zip(row[of_env] + 8, column[of_env] + first, strict=True))
        bearing = under_base(base, info["pose"][i], first)
        total += len(bearing)
        # A disc is guessed to be the square around it.
        assert places >= bearing if isinstance(base, Disc) and not observe else places == bearing
    assert total > 6 * len(bases)


def under_base(
    base: Base, pose: np.ndarray, first: int, last: int | None = None
) -> set[tuple[int, int]]:
    """Rotors (row, column) of a base's zone whose centres lie under it."""
    last = first + 15 if last is None else last
    rows = rows_under(np.ptp(base.outline[:, 1]), PITCH)
    places = np.indices((ROWS, last + 1)).reshape(2, -1)
    inside = outside(base, pose, PITCH * (places[1] + 0.5), PITCH * (places[0] + 0.5)) <= 0.0
    on_line = np.abs(places[0] - (ROWS - 1) / 2) < rows / 2
    return set(map(tuple, places.T[inside & on_line & (places[1] >= first)].tolist()))


@pytest.mark.parametrize("side", [1, -1])
def test_a_module_sees_the_axes_of_its_quadrant(side) -> None:
    groups = ("parcel", "rotors")
    env = sg.SmartSurfaceVectorEnv(
        1, observe=groups, info=("axes",), actuators=Actuators(axis_speed=10.0)
    )
    view = module_policy.SortModuleView(env.config)
    seen, info = env.reset(seed=0, options={"speed": 2.5, "parcel": "B", "side": side})
    rng = np.random.default_rng(1)
    for _ in range(6):
        seen, _, _, _, info = env.step(rng.integers(4, size=(1, 64)))
    modules = view(seen)
    actor = module_policy.make_actor(env.config, (8,))
    assert modules.shared.shape == (1, actor._alike.in_features)
    assert modules.place.shape == (len(modules.index), actor._apart.in_features)
    np.testing.assert_array_equal(modules.shared[0, -15:], seen[0, -15:])
    x, y = info["pose"][0, :2]
    under = np.array(list(under_base(Rectangle(0.45, 0.45), info["pose"][0], 0)))
    row, column = under.T
    twice = 2.0 * info["axes"][0][row, column]
    beyond = (PITCH * (column + 0.5) > x, side * (PITCH * (row + 0.5) - y) > 0.0)
    ahead, left = modules.place[:, 6] > 0.0, modules.place[:, 7] > 0.0
    for quadrant in np.ndindex(2, 2):
        mine = (ahead == quadrant[0]) & (left == quadrant[1])
        theirs = twice[(beyond[0] == quadrant[0]) & (beyond[1] == quadrant[1])]
        assert mine.any()
        assert theirs.size
        mean = [np.cos(theirs).mean(), side * np.sin(theirs).mean()]
        np.testing.assert_allclose(modules.place[mine, 10:], [mean] * mine.sum(), atol=1e-5)


def test_modules_that_will_be_under_the_parcel_are_seen_and_others_stay_at_90_deg() -> None:
    env = sg.SmartSurfaceVectorEnv(NUM_ENVS)
    starts = [{"speed": 2.7, "parcel": "S", "side": 1}] * NUM_ENVS
    observation, _ = env.reset(seed=0, options=starts)
    view = module_policy.SortModuleView(env.config)
    before = view(observation)
    for _ in range(6):
        observation, *_ = env.step(np.full((NUM_ENVS, 64), 3))
        after = view(observation)
        assert set(after.index[after.place[:, 4] == 1.0]) <= set(before.index)
        before = after
    count = len(before.index)
    actions = view.actions(observation, before, np.zeros(count, dtype=np.int64))
    assert ((actions == 0).sum(), (actions == 3).sum()) == (count, actions.size - count)
    assert count > 0


@pytest.mark.parametrize("parcel", ["S", "B"])
def test_the_other_side_is_the_mirror_image(parcel) -> None:
    view, left, pose = on_the_way(parcel, 1)
    _, right, other = on_the_way(parcel, -1)
    np.testing.assert_allclose(other[:, 1] - LINE_Y, LINE_Y - pose[:, 1], atol=1e-9)
    one, two = view(left), view(right)
    order = np.lexsort((one.place[:, 7], one.place[:, 6].round(3), one.env))
    image = np.lexsort((two.place[:, 7], two.place[:, 6].round(3), two.env))
    np.testing.assert_allclose(two.place[image], one.place[order], atol=1e-4)
    np.testing.assert_allclose(two.shared, one.shared, atol=1e-4)
    rng = np.random.default_rng(1)
    choices = rng.integers(4, size=len(order))
    towards, away = np.empty_like(choices), np.empty_like(choices)
    towards[order], away[image] = choices, choices
    actions = view.actions(left, one, towards).reshape(NUM_ENVS, 4, 16)
    mirrored = view.actions(right, two, away).reshape(NUM_ENVS, 4, 16)
    np.testing.assert_array_equal(mirrored, np.array([0, 2, 1, 3])[actions[:, ::-1]])


def test_other_configurations_are_refused() -> None:
    with pytest.raises(ValueError, match="task must be one of 'sort'"):
        module_policy.SortModuleView(EnvConfig(task="slow", actions="modules"))
    with pytest.raises(ValueError, match="actions must be one of 'modules'"):
        module_policy.SortModuleView(EnvConfig(actions="halves"))


SQUARES = tuple(Rectangle(side, side) for side in (0.15, 0.25, 0.4, 0.45, 0.55))
DISCS = tuple(Disc(radius) for radius in (0.1, 0.15, 0.199, 0.2, 0.225))
HEXAGON = Polygon(0.2 * np.array([(np.cos(k), np.sin(k)) for k in np.pi / 3.0 * np.arange(6)]))


def seen_turned(
    bases: tuple[Base, ...], observe: tuple[str, ...] = ()
) -> tuple[EnvConfig, np.ndarray, list[Base]]:
    """The configuration, observations, and the base of each environment, turned at random."""
    each = [base for base in bases for _ in range(20)]
    env = sg.SmartSurfaceVectorEnv(
        len(each), observe=observe, randomisation=Randomisation(lateral=0.05, heading=0.5)
    )
    starts = [{"speed": 2.0, "parcel": Parcel(base), "side": 1} for base in each]
    seen, info = env.reset(seed=0, options=starts)
    assert np.ptp(info["pose"][:, 2]) > 1.0
    return env.config, seen, each


def find_outlines(
    config: EnvConfig, seen: np.ndarray
) -> list[tuple[decoding.LineReading, Outline]]:
    """What is seen of parcels that are to go to y > 0, and their outlines."""
    sight, shown = decoding.look_at_line(config), find_shown(config)
    lines = [see_line(row, sight) for row in seen]
    return [
        (line, find_outline(row, line, sight, shown, line.theta, line.y))
        for row, line in zip(seen, lines, strict=True)
    ]


def assert_outlines(outlines: list[Outline], bases: list[Base]) -> None:
    half = np.array([np.ptp(base.outline, axis=0) / 2.0 for base in bases])
    found = [(each.length, each.width) for each in outlines]
    np.testing.assert_allclose(found, half, atol=2e-6)
    rows = [rows_under(2.0 * width, PITCH) for _, width in half]
    assert [each.rows for each in outlines] == rows


@pytest.mark.parametrize(
    "bases", [SQUARES, RECTANGLES, DISCS], ids=["squares", "rectangles", "discs"]
)
def test_the_clearance_determines_width_and_rows(bases) -> None:
    config, seen, each = seen_turned(bases)
    found = find_outlines(config, seen)
    assert_outlines([outline for _, outline in found], each)
    assert not any(outline.roundness for _, outline in found)
    if bases is SQUARES:  # as wide as long, to the last bit
        for line, outline in found:
            assert outline.length == outline.width == line.half_length
            assert find_reach(*outline[:3], line.theta) == line.reach


@pytest.mark.parametrize(
    ("bases", "roundness"),
    [(SQUARES + RECTANGLES, 0.0), (DISCS, 1.0), ((HEXAGON,), 0.25 / (1.0 - np.pi / 4.0))],
)
def test_an_observed_outline_is_exact(bases, roundness) -> None:
    config, seen, each = seen_turned(bases, ("parcel",))
    outlines = [outline for _, outline in find_outlines(config, seen)]
    assert_outlines(outlines, each)
    found = [outline.roundness for outline in outlines]
    np.testing.assert_allclose(found, min(roundness, 1.0), atol=1e-5)


def test_rows_of_a_pattern_are_its_own() -> None:
    rotor = np.zeros((20, 30), dtype=bool)
    rotor[7:13] = True
    shown = find_shown(EnvConfig("sort", actions="modules", line=Pattern(rotor, lead_in=4)))
    assert count_rows(3.5, shown) == count_rows(1.0, shown) == 6.0
