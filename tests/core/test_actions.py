"""Which module follows which part of an action, stated again in plain Python."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.actions import ActionKind
from surface_gym.core.batch import Batch
from surface_gym.lines import ORIENTATIONS
from surface_gym.randomisation import Actuators
from surface_gym.tasks.sort import FEATURES
from surface_gym.tasks.start import Start
from tests.environments import ACTIONS, ORIGIN, PARCELS, PITCH, batch_with, put

# [m, m, rad] before, in and behind the zone, left and right of the line's middle.
POSES = [
    (1.0, 1.0, 0.0), (0.62, 1.03, 0.2), (0.31, 0.96, -0.7), (1.0, 1.12, 2.5), (1.87, 0.91, 0.4),
    (2.2, 1.0, 0.0), (0.125, 1.0, 0.0), (1.05, 1.0, 0.0),
]  # fmt: skip
PARCEL = PARCELS["S"]
Pose = tuple[float, float, float]


def batch_at(pose: Pose, parcel: sg.Parcel, side: float = 1.0, **settings: Any) -> Batch:
    """One environment on which a parcel has just been put."""
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
    """The modules turn around what the sensor says, not around the truth."""
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
        x, y, theta = batch.parcels.sensed[0, :3]
        rows, columns = np.indices((5, 5))
        rows += whole_row(y) - 2
        columns += math.floor((x - ORIGIN) / PITCH + 0.5) - 2
        dx, dy = ORIGIN + PITCH * columns - x, ORIGIN + PITCH * rows - y
        cosine, sine = math.cos(theta), math.sin(theta)
        centre_x, centre_y = parcel.base.centroid
        functions = parcel.base.functions(
            centre_x + cosine * dx + sine * dy, centre_y + cosine * dy - sine * dx
        )
        under = (functions <= 0.0).all(axis=0)
        inside = (columns >= 0) & (columns < 30)
        obeys = np.zeros((5, 5), dtype=bool)
        obeys[inside] = batch.view(0).obeys[rows[inside], columns[inside]]
        np.testing.assert_array_equal(self.occupied(batch), under & obeys)

    def test_of_the_other_side_is_upside_down(self) -> None:
        """Asked to y < 0 a parcel sees what it would see in the mirror."""
        views = []
        for side, pose in ((1.0, (0.9, 1.04, 0.3)), (-1.0, (0.9, 0.96, -0.3))):
            batch = batch_at(pose, sg.layouts.box("B"), side, actions="window")
            views.append(self.occupied(batch))
        assert 0.0 < views[0].sum() < 25.0
        np.testing.assert_array_equal(views[0], views[1])


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
