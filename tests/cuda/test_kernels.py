"""Functions made again, with less scratch, do what the compiled ones do: to the bit, in plain
Python.
"""

import inspect

import numpy as np

from surface_gym.core.assembly import task_functions
from surface_gym.core.batch import Batch
from surface_gym.core.kernel import make_kernel
from surface_gym.cuda.kernels import Source
from surface_gym.cuda.memory import capacity_of, layout
from surface_gym.physics import types
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import Scratch
from tests.cuda.cases import every_case, settings_of


def plain(function):
    return function


def scratch_of(places) -> Scratch:
    marks = np.zeros(places["MARKS_SIZE"], dtype=np.int64)
    marks[places["SPANS"]] = -1
    return Scratch(np.zeros(places["TABLE_SIZE"]), marks)


@every_case
def test_a_lane_moves_as_in_the_compiled_batch(name):
    settings = settings_of(name)
    places = layout(capacity_of(settings))
    move_lanes = Source(places, plain).remade(make_kernel(task_functions(settings)))
    assert inspect.isfunction(move_lanes)
    batches = [Batch(settings, 1) for _ in range(2)]
    compiled, python = batches
    for batch in batches:
        batch.seed(0, np.random.default_rng(4))
    lane, scratches = np.arange(1), (scratch_of(places), scratch_of(places))
    compiled.start(lane)
    python._place_drawn(lane)
    space = settings.action_space()
    space.seed(0)
    with np.errstate(all="ignore"):  # as compiled code has it
        for _ in range(5):
            assert move_lanes(*python._arrays, *scratches, lane) == 0
            for one, other in zip(compiled.lanes, python.lanes, strict=True):
                np.testing.assert_array_equal(one, other)
            commands = settings.action_kind.commands([space.sample()], 1)
            compiled.advance(commands)
            python.surfaces.command[:] = commands


def test_a_function_is_made_once_and_its_callees_with_it():
    source = Source(layout(8), plain)
    made = source.remade(twice)
    assert made is source.remade(twice)
    assert made(3) == 2 * (3 + 8)
    assert made.__globals__["once"] is source.remade(once)
    assert twice.py_func.__globals__["once"] is once  # the original refers to what it did


def test_only_constants_of_the_scratch_are_exchanged():
    source = Source(layout(8), plain)
    assert source.remade(of_its_own)() == "mine"
    assert source.remade(through_a_closure(ARM_Y))() == 8


def test_functions_may_call_themselves():
    assert Source(layout(8), plain).remade(factorial)(5) == 120


CAPACITY = types.CAPACITY
ARM_Y = types.ARM_Y
NORMAL = "mine"


@inlined
def once(value):
    return value + CAPACITY


@inlined
def twice(value):
    return 2 * once(value)


@inlined
def of_its_own():
    return NORMAL


@inlined
def factorial(n):
    return 1 if n < 2 else n * factorial(n - 1)


def through_a_closure(ARM_Y):
    @inlined
    def place():
        return ARM_Y

    return place
