"""Axes that turn under load in MuJoCo: what scrubbing takes, and what it does to a parcel."""

import math

import numpy as np
import pytest

import surface_gym as sg
from benchmarks.swivelling import SPEED, SwivelCase, main
from surface_gym.physics.types import GRAVITY
from surface_gym.validation.simulation import (
    RECIPE,
    Swivel,
    build,
    load_mujoco,
    normal_forces,
    static_sag,
)

pytestmark = pytest.mark.usefixtures("mujoco")


@pytest.mark.parametrize("patch", [0.0, 0.001, 0.003])
def test_the_torque_of_a_turning_axis_is_that_of_an_even_patch(patch):
    """A box at rest on four rotors; the pressure on a disc of radius a gives 2/3 mu N a."""
    mujoco = load_mujoco()
    axis = np.full((2, 2), math.pi / 4)
    surface = sg.Surface(axis, np.ones((2, 2), dtype=bool))
    box = sg.Parcel(sg.Rectangle(0.18, 0.18), mass=8.0)
    swivel = Swivel(np.zeros((2, 2)), 0.0, SPEED, patch)
    scene = build(surface, box, RECIPE, swivel=swivel)
    data, model = mujoco.MjData(scene.model), scene.model
    data.qpos[:7] = (
        0.1,
        0.1,
        -static_sag(np.zeros(4), np.full(4, RECIPE.stiffness), GRAVITY),
        1,
        0,
        0,
        0,
    )
    dofs = model.body_dofadr[model.body_dofnum == 2]
    assert len(dofs) == 4
    for _ in range(200):
        data.qvel[dofs] = SPEED
        mujoco.mj_step(model, data)
    _, loads = normal_forces(data)
    np.testing.assert_allclose(loads, 8.0 * GRAVITY / 4, rtol=1e-3)
    torque = -data.qfrc_constraint[dofs]
    np.testing.assert_allclose(torque, 2.0 / 3.0 * 0.5 * loads * patch, rtol=0.02, atol=1e-9)


@pytest.mark.parametrize(("seed", "alike"), [(0, False), (1, True)])
def test_the_package_agrees_with_point_contacts_and_patches_hardly_matter(seed, alike):
    case = SwivelCase(seed, alike)
    point, patched, ours = case.mujoco(0.0), case.mujoco(0.002), case.analytic(0.001)
    fixed = case.analytic(0.001, math.inf)
    assert np.hypot(*(ours - point)[:2]) < 0.008
    assert abs(ours[2] - point[2]) < math.radians(0.7)
    # It did matter that the axes turned.
    assert np.hypot(*(ours - fixed)[:2]) > 0.02
    assert abs(patched[2] - point[2]) < case.bound(0.002)
    assert np.hypot(*(patched - point)[:2]) < 0.001


def test_the_report_names_the_bound(capsys):
    main(["--cases", "1", "--workers", "1"])
    said = capsys.readouterr().out
    assert "patches of 5 mm: at most" in said
