"""Beside: MuJoCo Warp, with a box pushed over an array of rotors and supports."""

import math
import time
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.gpu.windows import Effort, Rate, rate_of
from surface_gym.physics.types import GRAVITY
from surface_gym.validation.comparison import PARCEL, PUSHED
from surface_gym.validation.simulation import (
    RECIPE,
    Recipe,
    build,
    elements_under,
    load_mujoco,
    reachable,
    static_sag,
)

MUJOCO_WARP = find_spec("mujoco_warp") is not None  # which needs mujoco and warp
PERIOD = 0.04  # [s] of a decision, as Sort's
REACH = 0.4  # [s] of motion whose elements are built
MOST_CONTACTS = 32  # of the box: 9 elements lie under it at most
MOST_ROWS = 3 * MOST_CONTACTS  # of constraints: a normal force and two of friction
EFFORT = Effort(windows=3, steps=1, seconds=1.0, chunk=1, settling=1)


class WarpScene:
    """The validation's scene of a push, in as many worlds; one is a lane.

    Its box weighs half of Sort's, the axes stay at 45 deg, and none observes, scores or ends. The
    bearings' friction, which grows with the load and MuJoCo has no name for, is left out: MuJoCo
    has less to do than our lanes. Its step is the
    validation's, at which MuJoCo agrees with the model: a decision has hundreds.

    Args:
        lanes: their number.
        recipe: step and contacts.
    """

    def __init__(self, lanes: int, recipe: Recipe = RECIPE) -> None:
        mujoco = load_mujoco()
        warp = import_module("warp")
        warp.config.log_level = 30  # warnings, and not each kernel that is compiled
        mujoco_warp = import_module("mujoco_warp")
        self._warp, self._mujoco_warp = warp, mujoco_warp
        self.lanes = lanes
        self.steps = round(PERIOD / recipe.step)  # of a decision
        self.name = f"MuJoCo Warp, a box pushed, {warp.get_device().name}"
        surface, pose, velocity = PUSHED.surface, PUSHED.pose, PUSHED.velocity
        scene = build(
            surface, PARCEL, recipe, within=reachable(surface, PARCEL, pose, velocity, REACH)
        )
        data = mujoco.MjData(scene.model)
        bearing = elements_under(surface, PARCEL, pose)
        stiffness = recipe.stiffness * surface.grid.stiffness[bearing]
        sag = static_sag(np.zeros(len(stiffness)), stiffness, GRAVITY)
        half_turn = 0.5 * pose[2]
        data.qpos[:7] = pose[0], pose[1], -sag, math.cos(half_turn), 0, 0, math.sin(half_turn)
        data.qvel[:6] = velocity[0], velocity[1], 0, 0, 0, velocity[2]
        mujoco.mj_forward(scene.model, data)
        begin = time.perf_counter()
        self._model = mujoco_warp.put_model(scene.model)
        self.data = mujoco_warp.put_data(
            scene.model, data, nworld=lanes, nconmax=MOST_CONTACTS, njmax=MOST_ROWS
        )
        self._start = warp.clone(self.data.qpos), warp.clone(self.data.qvel)
        mujoco_warp.step(self._model, self.data)
        self._graph: Any = None
        if warp.get_device().is_cuda:
            with warp.ScopedCapture() as capture:
                mujoco_warp.step(self._model, self.data)
            self._graph = capture.graph
        warp.synchronize()
        self.first = time.perf_counter() - begin
        self._decisions = 0

    def step(self, steps: int) -> None:
        """Move over so many decisions; from the start again before the box leaves what is built.

        Raises:
            RuntimeError: MuJoCo Warp diverged.
        """
        for _ in range(steps):
            if self._decisions % int(REACH / PERIOD) == 0:
                self._warp.copy(self.data.qpos, self._start[0])
                self._warp.copy(self.data.qvel, self._start[1])
            for _ in range(self.steps):
                if self._graph is None:
                    self._mujoco_warp.step(self._model, self.data)
                else:
                    self._warp.capture_launch(self._graph)
            self._decisions += 1
        if not np.isfinite(self.data.qpos.numpy()).all():
            raise RuntimeError("MuJoCo Warp diverged")

    def begun(self) -> int:
        return 0  # none ends


def warp_rate(lanes: int) -> Rate:
    """Decisions a second of so many worlds."""
    return rate_of(WarpScene(lanes), EFFORT)
