"""A batch's environments: which module follows which part of an action, stated again in plain
Python; what a parcel brings to them, and how it is put there.
"""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.actions import ActionKind
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.core.resets import NO_EDGE, place_parcel
from surface_gym.lines import ORIENTATIONS, Field, Line
from surface_gym.physics.types import COM_X, COM_Y, HALF_LENGTH, RADIUS
from surface_gym.randomisation import Actuators
from surface_gym.tasks.sort import FEATURES
from surface_gym.tasks.start import Start
from tests.environments import (
    ACTIONS,
    HEPTAGON,
    ORIGIN,
    PARCELS,
    PITCH,
    TRIANGLE,
    batch_with,
    outside,
    put,
)

# [m, m, rad] before, in and behind the zone, left and right of the line's middle.
POSES = [
    (1.0, 1.0, 0.0), (0.62, 1.03, 0.2), (0.31, 0.96, -0.7), (1.0, 1.12, 2.5), (1.87, 0.91, 0.4),
    (2.2, 1.0, 0.0), (0.125, 1.0, 0.0), (1.05, 1.0, 0.0),
]  # fmt: skip
PARCEL = PARCELS["S"]
Pose = tuple[float, float, float]


def batch_at(pose: Pose, parcel: sg.Parcel, side: float = 1.0, **settings: Any) -> Batch:
    return batch_with(Start(parcel, pose, (0.5, 0.0, 0.0), (side,)), **settings)


def whole_row(place: float) -> int:
    """The nearest row; midway between two the upper one, whatever the round-off."""
    return math.floor((place - ORIGIN) / PITCH + 0.5 + 1e-9)


def part_of(actions: str, batch: Batch, row: int, column: int) -> int | None:
    """The part of an action that a module of the zone follows, as `SmartSurfaceEnv` has it."""
    x, y = batch.parcels.sensed[0, :2]
    first_row, rows, first_column, columns = batch.view(0).zone
    ahead = ORIGIN + PITCH * column >= x
    left = ORIGIN + PITCH * row >= y
    if actions == "modules":  # row by row of the widest line, of which these are the middle ones
        return int((row - first_row + (4 - rows) // 2) * columns + column - first_column)
    if actions == "halves":
        return 0 if ahead else 1
    if actions == "quadrants":
        return [(True, True), (True, False), (False, True), (False, False)].index((ahead, left))
    down = row - whole_row(y) + 2
    along = column - math.floor((x - ORIGIN) / PITCH + 0.5) + 2
    return 5 * down + along if 0 <= down < 5 and 0 <= along < 5 else None


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("size", ["S", "B"])
@pytest.mark.parametrize("actions", ACTIONS)
def test_each_module_follows_its_part(actions: str, size: str, pose: Pose) -> None:
    batch = batch_at(pose, sg.layouts.box(size), actions=actions)
    assert_follows(batch, np.random.default_rng(1).integers(0, 4, batch.surfaces.command.shape))


@pytest.mark.parametrize("actions", ACTIONS)
def test_each_module_turns_to_the_angle_its_part_says(actions: str) -> None:
    batch = batch_at((1.0, 1.12, 2.5), sg.layouts.box("B"), actions=actions, orientations="any")
    right = math.pi / 2
    command = np.random.default_rng(1).uniform(-right, right, batch.surfaces.command.shape)
    assert_follows(batch, command)
    put(batch, Start(PARCEL, (0.2, 1.0, 0.0), (0.5, 0.0, 0.0), (1.0,)))
    np.testing.assert_allclose(batch.axes(0), math.pi / 2, rtol=0.0, atol=1e-15)


def assert_follows(batch: Batch, command: np.ndarray) -> None:
    """Each module of the zone turns as its part of the command says, every other stays."""
    state, any_angle = batch.view(0), batch.config.action_kind.continuous
    wanted = np.full(state.rotor.shape, math.pi / 2)
    for row, column in zip(*np.nonzero(state.obeys), strict=True):
        part = part_of(batch.config.actions, batch, int(row), int(column))
        if part is not None:
            says = command[0, part]
            wanted[row, column] = says if any_angle else ORIENTATIONS[says]
    batch.step(command)
    np.testing.assert_allclose(batch.axes(0), wanted, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("actions", ["halves", "quadrants", "window"])
def test_around_the_parcel_is_where_it_is_sensed(actions: str) -> None:
    batch = batch_at((1.0, 1.0, 0.0), PARCEL, actions=actions)
    batch.parcels.sensed[0, :2] = 0.83, 1.07
    assert_follows(batch, np.random.default_rng(2).integers(0, 3, batch.surfaces.command.shape))


class TestOccupancy:
    """What "window" adds to the observation."""

    @staticmethod
    def occupied(batch: Batch) -> np.ndarray:
        """(5, 5) rows from y < 0 on."""
        return batch.parcels.observation[0, len(FEATURES) :].reshape(5, 5)

    @pytest.mark.parametrize("pose", POSES)
    @pytest.mark.parametrize("name", PARCELS)
    def test_is_of_modules_that_obey_under_the_parcel(self, name: str, pose: Pose) -> None:
        parcel = PARCELS[name]
        batch = batch_at(pose, parcel, actions="window", actuators=Actuators(stuck=((9, 9),)))
        pose = x, y, _ = batch.parcels.sensed[0, :3]
        rows, columns = np.indices((5, 5))
        rows += whole_row(y) - 2
        columns += math.floor((x - ORIGIN) / PITCH + 0.5) - 2
        places = ORIGIN + PITCH * columns, ORIGIN + PITCH * rows
        under = outside(parcel.base, pose, *places, parcel.base.centroid) <= 0.0
        inside = (columns >= 0) & (columns < 30)
        obeys = np.zeros((5, 5), dtype=bool)
        obeys[inside] = batch.view(0).obeys[rows[inside], columns[inside]]
        np.testing.assert_array_equal(self.occupied(batch), under & obeys)

    def test_of_the_other_side_is_upside_down(self) -> None:
        views = []
        for side, pose in ((1.0, (0.9, 1.04, 0.3)), (-1.0, (0.9, 0.96, -0.3))):
            batch = batch_at(pose, sg.layouts.box("B"), side, actions="window")
            views.append(self.occupied(batch))
        assert 0.0 < views[0].sum() < 25.0
        np.testing.assert_array_equal(views[0], views[1])


@pytest.mark.usefixtures("uncompiled")
def test_instant_axes_take_no_memory_to_turn() -> None:
    for actuators, shape in ((Actuators(), (3, 1, 1)), (Actuators(axis_speed=1.0), (3, 20, 30))):
        surfaces = Batch(EnvConfig(actuators=actuators), 3).surfaces
        assert surfaces.angle.shape == surfaces.target.shape == shape


ROWS, COLUMNS = 4, 3


def kind_of(name: str, choices: int = 4) -> ActionKind:
    return ActionKind(name, choices, ROWS, COLUMNS)


@pytest.mark.parametrize("name", ACTIONS)
@pytest.mark.parametrize("choices", [2, 4, 8])
def test_commands_say_the_same_and_flipping_twice_is_nothing(name: str, choices: int) -> None:
    kind = kind_of(name, choices)
    space = kind.space()
    space.seed(0)
    actions = np.array([space.sample() for _ in range(50)])
    commands = kind.commands(actions, 50)
    assert commands.shape == (50, kind.size)
    assert (commands.min(), commands.max()) == (0, choices - 1)
    np.testing.assert_array_equal(kind.encode(commands), actions)
    kept = commands.copy()
    flipped = kind.flip(commands)
    np.testing.assert_array_equal(commands, kept)  # they are the caller's
    np.testing.assert_array_equal(kind.flip(flipped), commands)
    np.testing.assert_array_equal(np.sort(flipped), np.sort(commands))


def test_an_action_of_halves_is_front_and_rear() -> None:
    kind = kind_of("halves")
    assert kind.commands([0, 1, 4, 14, 15], 5).tolist() == [[0, 0], [0, 1], [1, 0], [3, 2], [3, 3]]


def test_flips_row_by_row_and_left_and_right_of_quadrants() -> None:
    for name, shape in (("modules", (ROWS, COLUMNS)), ("window", (5, 5))):
        given = np.arange(np.prod(shape))
        flipped = kind_of(name).flip(given[np.newaxis]).reshape(shape)
        np.testing.assert_array_equal(flipped, given.reshape(shape)[::-1])
    assert kind_of("halves").flip(np.array([[1, 2]])).tolist() == [[1, 2]]
    front_left, front_right, rear_left, rear_right = 0, 1, 2, 3
    given = np.array([[front_left, front_right, rear_left, rear_right]])
    wanted = [[front_right, front_left, rear_right, rear_left]]
    assert kind_of("quadrants").flip(given).tolist() == wanted


@pytest.mark.parametrize("name", ["fingers", "", None, 3, "Modules"])
def test_an_unknown_kind_is_named(name: object) -> None:
    with pytest.raises(ValueError, match="actions must be one of 'modules', 'halves'"):
        kind_of(name)


every_parcel = pytest.mark.parametrize("parcel", PARCELS.values(), ids=PARCELS)


@every_parcel
def test_corners_and_edges_are_the_bases(parcel: sg.Parcel) -> None:
    placement = place_parcel(parcel, Line(), None)
    np.testing.assert_array_equal(placement.edges, parcel.base.edges)
    corners = placement.corners + parcel.base.centroid
    if isinstance(parcel.base, sg.Disc):
        np.testing.assert_array_equal(placement.corners, [[0.0, 0.0]])
    else:
        np.testing.assert_allclose(corners, parcel.base.outline, atol=1e-15)
    assert placement.body[RADIUS] == parcel.base.reach
    assert placement.body[[COM_X, COM_Y]].tolist() == list(parcel.com_offset)
    rear = parcel.base.outline[:, 0].min() - parcel.base.centroid[0]
    assert placement.body[HALF_LENGTH] == pytest.approx(-rear)


@every_parcel
def test_only_rotors_of_the_zone_obey(parcel: sg.Parcel) -> None:
    placement = place_parcel(parcel, Line(), (7, 9))
    rows, columns = np.nonzero(placement.obeys)
    assert set(columns.tolist()) == {7, 8, 9}
    assert placement.rotor[rows, columns].all()
    everywhere = place_parcel(parcel, Field(8, 10), None)
    assert everywhere.obeys.all()


@every_parcel
@pytest.mark.parametrize("velocity", [(1.0, 0.0, 0.0), (0.5, -0.3, 4.0)])
def test_a_start_gives_its_pose(parcel: sg.Parcel, velocity: tuple[float, float, float]) -> None:
    """The state is the centre of mass's; the pose reported is the centroid's, as a body moves."""
    pose = (0.7, 1.05, 0.6)
    batch = batch_with(Start(parcel, pose, velocity, (1.0,)))
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    x, y = parcel.base.centroid
    arm = np.array([cosine * x - sine * y, sine * x + cosine * y])
    vx, vy, omega = velocity
    wanted = [*(arm + pose[:2]), pose[2], vx - omega * arm[1], vy + omega * arm[0], omega]
    np.testing.assert_allclose(batch.parcels.truth[0], wanted, rtol=0, atol=1e-14)


def test_a_start_forgets_the_parcel_before() -> None:
    start = Start(sg.layouts.box("S"), (0.125, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,))
    used, fresh = Batch(EnvConfig(), 1), batch_with(start)
    for parcel in (HEPTAGON, sg.layouts.box("B"), TRIANGLE):
        put(used, start._replace(parcel=parcel))
        used.step(np.full((1, 64), 1))
    put(used, start)
    view = used.view(0)
    for name, found, wanted in zip(view._fields, view, fresh.view(0), strict=True):
        if name in ("edges", "corners"):  # the heptagon's seven leave room behind the box's four
            np.testing.assert_array_equal(found[:4], wanted)
        elif name != "memory":
            np.testing.assert_array_equal(found, wanted, name)
    np.testing.assert_array_equal(view.edges[4:], [NO_EDGE] * 3)
    assert (view.corners[4:] == view.corners[0]).all()


def test_equal_parcels_share_a_row_of_the_body_table() -> None:
    batch = Batch(EnvConfig(), 5)
    mine = sg.Parcel(sg.Disc(0.12))
    boxes = [sg.layouts.box(size) for size in "SBSB"]  # equal, not the same
    for i, parcel in enumerate([*boxes, mine]):
        put(batch, Start(parcel, (parcel.rear, 1.0, 0.0), (1.0, 0.0, 0.0), (1.0,)), i)
    assert batch.parcels.body[:4].tolist() == [0, 1, 0, 1]
    assert [batch.view(i).body[RADIUS] for i in (0, 4)] == [sg.layouts.box("S").base.reach, 0.12]
