"""Modules of small kernels: what they are given, what they return, and what is refused."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from surface_gym.compiler import wasm as compiler
from surface_gym.compiler.jit import compiled, kernel_function
from surface_gym.compiler.wasm import Module, compile_module
from surface_gym.compiler.wasm_image import BASE, make_image
from surface_gym.compiler.wasm_linker import link

wasmtime = pytest.importorskip("wasmtime", reason="wasmtime is not installed (extra 'web')")


class Inner(NamedTuple):
    factor: float
    wide: np.ndarray


class Outer(NamedTuple):
    inner: Inner
    marks: np.ndarray
    count: int


@kernel_function
def put(values, place, value):
    values[place] = value


@compiled
def kernel(outer, small, places, scratch, place):
    scratch.total[0] = 0.0
    for row in range(outer.inner.wide.shape[0]):
        for column in range(outer.inner.wide.shape[1]):
            scratch.total[0] += outer.inner.wide[row, column]
    put(small, place, outer.inner.factor * scratch.total[0])
    outer.marks[0] = not outer.marks[0]
    places[1] -= 5
    return outer.count + 1


class Memory(NamedTuple):
    total: np.ndarray


def make_arguments(place=1):
    outer = Outer(Inner(0.5, np.arange(6.0).reshape(2, 3)), np.array([True, False]), 41)
    small, places = np.zeros(2, np.float32), np.array([7, 3], np.int32)
    return outer, small, places, Memory(np.ones(4)), place


@pytest.fixture(scope="module")
def module() -> Module:
    return compile_module(kernel, make_arguments())


@pytest.fixture
def machine(module):
    from surface_gym.compiler.wasm_machine import Machine

    made = Machine(module)
    made.load(make_image(kernel, make_arguments()))
    return made


def test_it_returns_and_writes_what_the_kernel_does(machine):
    assert machine.step() == 42
    assert machine.view("small").tolist() == [0.0, 7.5]
    assert machine.view("outer.marks").tolist() == [False, False]
    assert machine.view("places").tolist() == [7, -2]
    assert machine.view("outer.inner.wide").tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]


def test_arrays_and_numbers_can_be_written_between_calls(machine):
    machine.view("outer.inner.factor")[...] = 2.0
    machine.view("outer.count")[...] = 9
    machine.view("outer.inner.wide")[:] = 1.0
    assert machine.step() == 10
    assert machine.view("small")[1] == 12.0


def test_an_index_out_of_bounds_is_reported(machine):
    machine.view("place")[...] = 2
    assert machine.step() == -1


def test_an_image_of_more_memory_than_there_was_is_loaded(machine):
    outer, *rest = make_arguments()
    wide = np.ones((100, 1000))
    machine.load(make_image(kernel, (outer._replace(inner=Inner(1.0, wide)), *rest)))
    assert machine.step() == 42
    assert machine.view("small")[1] == 1e5


def test_the_layout_says_where_everything_lies():
    image = make_image(kernel, make_arguments())
    layout = image.layout()
    assert list(layout["fields"]) == [
        "outer.inner.factor", "outer.inner.wide", "outer.marks", "outer.count", "small", "places",
        "scratch.total", "place",
    ]  # fmt: skip
    kind, shape, address = layout["fields"]["outer.inner.wide"]
    values = np.frombuffer(image.block, kind, count=6, offset=address - layout["base"])
    assert values.reshape(shape).tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    ends = [field.address + field.size for field in image.fields if field.name != "scratch.total"]
    assert layout["base"] == BASE
    assert BASE + layout["bytes"] >= max(ends)
    assert layout["fields"]["scratch.total"][2] >= BASE + layout["bytes"]
    assert layout["end"] >= image.places["scratch.total"].address + 4 * 8


def test_the_same_source_gives_the_same_bytes(module):
    compiler._translator.cache_clear()
    assert compile_module(kernel, make_arguments()) == module


def test_a_kept_module_is_read_until_its_source_is_edited(tmp_path, monkeypatch):
    file = tmp_path / "modules" / "other.wasm"
    made = compile_module(other, (np.ones(3),), file)
    assert made.code == file.read_bytes()
    monkeypatch.setattr(compiler, "_compile", lambda *_: b"compiled anew")
    assert compile_module(other, (np.ones(5),), file) == made
    assert compile_module(other, (np.ones((3, 3)),), file).code.startswith(b"compiled anew")
    assert compile_module(edited, (np.ones(3),), file).code == file.read_bytes() != made.code
    file.write_bytes(made.code[:-9])  # cut short
    assert compile_module(other, (np.ones(3),), file).code.startswith(b"compiled anew")
    assert [each.name for each in file.parent.iterdir()] == ["other.wasm"]


def test_a_machine_refuses_an_image_of_another_kernel(machine):
    with pytest.raises(ValueError, match="image must be of the module's kernel"):
        machine.load(make_image(other, (np.ones(3),)))
    with pytest.raises(ValueError, match=r"name must be one of outer\.inner\.factor"):
        machine.view("nothing")


@compiled
def calls(x, y, found):
    for k in range(x.shape[0]):
        found[0, k], found[1, k] = math.sin(x[k]), math.cos(y[k])
        found[2, k] = math.hypot(x[k], y[k])
        found[3, k], found[4, k] = math.atan2(x[k], y[k]), math.exp(-abs(x[k]))
    return 1


def test_functions_of_c_are_those_of_the_cpu_and_some_are_the_module_s_own():
    import wasmtime

    from surface_gym.compiler.wasm_machine import Machine

    rng, many = np.random.default_rng(0), 10_000
    arguments = rng.uniform(-7.0, 7.0, many), rng.uniform(-1e4, 1e4, many), np.zeros((5, many))
    made = compile_module(calls, arguments, exports=("sin",))
    machine = Machine(made)
    machine.load(make_image(calls, arguments))
    assert machine.step() == calls(*arguments) == 1
    np.testing.assert_array_equal(machine.view("found"), arguments[-1])
    code = wasmtime.Module(wasmtime.Engine(), made.code)
    assert {str(each.name) for each in code.exports} == {"memory", "sin", "step"}
    assert {str(each.name) for each in code.imports} == {"atan2", "exp", "fmod"}


@compiled
def other(values):
    return len(values)


@compiled
def edited(values):
    return len(values) + 1


@pytest.mark.parametrize(
    "values",
    [np.ones((4, 4))[:, ::2], np.ones(3, np.int8), np.ones(3, complex), 1j, True],
    ids=["strided", "int8", "complex", "a complex number", "a truth"],
)
def test_arrays_and_numbers_that_no_kernel_has_are_refused(values):
    with pytest.raises(ValueError, match=r"values must be of .*, got"):
        make_image(other, (values,))


@pytest.mark.parametrize("code", [b"", b"\x7fELF", b"\0asm\2\0\0\0"])
def test_what_is_no_object_file_is_refused(code):
    with pytest.raises(ValueError, match="code must be a WebAssembly object file"):
        link(code, ("step",))
