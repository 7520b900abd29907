"""The package as a whole: what importing it brings, its names, pickles and copies."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

import surface_gym as sg

HEAVY = ("torch", "pygame", "matplotlib", "stable_baselines3", "mujoco", "rich", "tyro")


def test_importing_it_imports_nothing_that_only_training_or_drawing_needs() -> None:
    code = f"import sys, surface_gym; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_simulating_imports_none_of_them_either() -> None:
    code = (
        "import sys, surface_gym as sg\n"
        "sg.simulate(sg.layouts.sorting(), sg.layouts.box('S'), (1.0, 1.0, 0.0), duration=0.1)\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    assert all(hasattr(sg, name) for name in sg.__all__)
    assert {"Surface", "Parcel", "Rectangle", "Disc", "Polygon", "simulate", "layouts"} <= set(
        sg.__all__
    )


SURFACE = sg.layouts.sorting("B", tilt=0.1)
PARCELS = [
    sg.layouts.box("S"),
    sg.Parcel(sg.Disc(0.2), mass=3.0, com_offset=(0.01, 0.02)),
    sg.Parcel(sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.0, 0.3)]), inertia=0.2),
]


def by_pickle(value: object) -> object:
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize("twin", [by_pickle, copy.deepcopy, copy.copy])
@pytest.mark.parametrize("used", [False, True], ids=["new", "after a run"])
@pytest.mark.parametrize("parcel", PARCELS, ids=["rectangle", "disc", "polygon"])
def test_twins_simulate_the_same(twin: object, used: bool, parcel: sg.Parcel) -> None:
    surface = twin(SURFACE) if used else SURFACE
    first = sg.simulate(surface, parcel, (1.0, 1.0, 0.3), (1.0, 0.2, -0.5), 0.3)
    second = sg.simulate(twin(surface), twin(parcel), (1.0, 1.0, 0.3), (1.0, 0.2, -0.5), 0.3)
    assert first.pose.tobytes() == second.pose.tobytes()
    assert first.velocity.tobytes() == second.velocity.tobytes()


@pytest.mark.parametrize("twin", [by_pickle, copy.deepcopy])
def test_twins_have_the_same_fields(twin: object) -> None:
    surface = twin(SURFACE)
    np.testing.assert_array_equal(surface.axis, SURFACE.axis)
    np.testing.assert_array_equal(surface.rotor, SURFACE.rotor)
    assert (surface.tilt, surface.pitch, surface.origin) == (0.1, SURFACE.pitch, SURFACE.origin)
    run = sg.simulate(SURFACE, PARCELS[0], (1.0, 1.0, 0.0), duration=0.1)
    same = twin(run)
    assert same.end == run.end
    for field in ("time", "pose", "velocity", "tipping"):
        np.testing.assert_array_equal(getattr(same, field), getattr(run, field))


@pytest.mark.parametrize("twin", [by_pickle, copy.deepcopy, copy.copy])
def test_twins_are_read_only_too(twin: object) -> None:
    surface, polygon = twin(SURFACE), twin(PARCELS[2].base)
    for array in (surface.axis, surface.rotor, polygon.vertices):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = True
