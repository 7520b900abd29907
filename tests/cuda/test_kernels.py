"""Translated functions, with less scratch, equal the compiled ones to the bit, in plain Python."""

import inspect

import numpy as np

from surface_gym.core.assembly import task_functions
from surface_gym.core.batch import Batch
from surface_gym.core.kernel import make_kernel
from surface_gym.cuda.kernels import Translator
from surface_gym.cuda.memory import scratch_layout, task_capacity
from surface_gym.physics import types
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import Scratch
from tests.cuda.cases import every_case, make_config


def make_translator(capacity=8):
    return Translator(scratch_layout(capacity), lambda function: function)


def make_small_scratch(capacity):
    layout = scratch_layout(capacity)
    marks = np.zeros(layout["MARKS_SIZE"], dtype=np.int64)
    marks[layout["SPANS"]] = -1
    return Scratch(np.zeros(layout["TABLE_SIZE"]), marks)


@every_case
def test_an_environment_is_stepped_as_in_the_compiled_batch(name):
    config = make_config(name)
    capacity = task_capacity(config)
    step_envs = make_translator(capacity).translate(make_kernel(task_functions(config)))
    assert inspect.isfunction(step_envs)
    batches = [Batch(config, 1) for _ in range(2)]
    compiled, python = batches
    for batch in batches:
        batch.seed(0, np.random.default_rng(4))
    chosen, scratches = np.arange(1), [make_small_scratch(capacity) for _ in range(2)]
    compiled.reset(chosen)
    python.place_drawn(chosen)
    space = config.action_space()
    space.seed(0)
    with np.errstate(all="ignore"):  # as in compiled code
        for _ in range(5):
            assert step_envs(*python._arrays, *scratches, chosen) == 0
            for expected, given in zip(compiled.parcels, python.parcels, strict=True):
                np.testing.assert_array_equal(expected, given)
            commands = config.action_kind.commands([space.sample()], 1)
            compiled.step(commands)
            python.surfaces.command[:] = commands


def test_a_function_is_translated_once_with_those_it_calls():
    translator = make_translator()
    translated = translator.translate(twice)
    assert translated is translator.translate(twice)
    assert translated(3) == 2 * (3 + 8)
    assert translated.__globals__["once"] is translator.translate(once)
    assert twice.py_func.__globals__["once"] is once  # the original is as before


def test_only_constants_of_the_scratch_are_replaced():
    translator = make_translator()
    assert translator.translate(other_constant)() == "mine"
    assert translator.translate(make_closure(ARM_Y))() == 8


def test_functions_may_call_themselves():
    assert make_translator().translate(factorial)(5) == 120


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
def other_constant():
    return NORMAL


@inlined
def factorial(n):
    return 1 if n < 2 else n * factorial(n - 1)


def make_closure(ARM_Y):
    @inlined
    def row():
        return ARM_Y

    return row
