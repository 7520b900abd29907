"""Other packages on a GPU: gymnax's CartPole, and a box on rotors in MuJoCo Warp."""

import math
import os
import time
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.gpu.timing import Effort, Rate, measure_rate
from surface_gym.physics.types import GRAVITY
from surface_gym.validation.comparison import PARCEL, PUSHED
from surface_gym.validation.simulation import (
    RECIPE,
    build,
    elements_under,
    load_mujoco,
    reachable,
    static_sag,
)

GYMNAX = find_spec("gymnax") is not None
MUJOCO_WARP = find_spec("mujoco_warp") is not None  # which needs mujoco and warp
PERIOD = 0.04  # [s] of a decision, as Sort's
REACH = 0.4  # [s] of motion for which elements are built
MOST_CONTACTS = 32  # of the box: 9 elements lie under it at most
MOST_ROWS = 3 * MOST_CONTACTS  # of constraints: a normal force and two of friction
WARP_EFFORT = Effort(windows=3, steps=1, seconds=1.0, chunk=1, warm_up=1)


class CartPole:
    """gymnax's CartPole-v1 with random actions; episodes that end restart at once.

    Args:
        chunk: number of steps in one compiled call; `step` takes multiples of this number.
    """

    def __init__(self, num_envs: int, chunk: int) -> None:
        # JAX would keep most of the GPU's memory for itself.
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
        gymnax, jax = import_module("gymnax"), import_module("jax")
        env, parameters = gymnax.make("CartPole-v1")
        self.num_envs = num_envs
        self.name = f"gymnax CartPole, {jax.devices()[0].device_kind}"

        def one(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], None]:
            key, _, state, _ = carry
            key, for_actions, for_env = jax.random.split(key, 3)
            actions = jax.random.randint(for_actions, (num_envs,), 0, 2)
            stepped = jax.vmap(env.step, in_axes=(0, 0, 0, None))
            keys = jax.random.split(for_env, num_envs)
            # Observation and reward are returned, since JAX does not compute unused results.
            observation, state, reward, *_ = stepped(keys, state, actions, parameters)
            return (key, observation, state, reward), None

        @jax.jit
        def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
            result: tuple[Any, ...] = jax.lax.scan(one, carry, None, chunk)[0]
            return result

        begin = time.perf_counter()
        self._block, self._step = jax.block_until_ready, step
        keys = jax.random.split(jax.random.key(1), num_envs)
        observation, state = jax.vmap(env.reset, in_axes=(0, None))(keys, parameters)
        reward = jax.numpy.zeros(num_envs)
        self._carry: tuple[Any, ...] = (jax.random.key(0), observation, state, reward)
        self._chunk = chunk
        self.step(chunk)
        self.first = time.perf_counter() - begin

    def step(self, steps: int) -> None:
        """Step all environments, and wait for the GPU."""
        for _ in range(steps // self._chunk):
            self._carry = self._step(self._carry)
        self._block(self._carry)

    def episodes(self) -> int:
        """Return 0, since episodes are not counted."""
        return 0


def measure_cartpole(num_envs: int, effort: Effort) -> Rate:
    """Measure CartPole with random actions."""
    return measure_rate(CartPole(num_envs, effort.chunk), effort)


class WarpScene:
    """A box that is pushed over rotors, as in the validation, in many worlds of MuJoCo Warp.

    MuJoCo Warp has less to do than Sort's environments: the box weighs half as much, the axes stay
    at 45 deg, and there are no observations, rewards or ends. The bearings' friction is left out,
    since MuJoCo does not model that it grows with the load. The time step is the validation's, at
    which MuJoCo agrees with the package: a decision has hundreds of steps.
    """

    def __init__(self, num_envs: int) -> None:
        mujoco = load_mujoco()
        warp = import_module("warp")
        warp.config.log_level = 30  # warnings, and not each kernel that is compiled
        mujoco_warp = import_module("mujoco_warp")
        self._warp, self._mujoco_warp = warp, mujoco_warp
        self.num_envs = num_envs
        self.steps = round(PERIOD / RECIPE.step)  # of a decision
        self.name = f"MuJoCo Warp, a box pushed, {warp.get_device().name}"
        surface, pose, velocity = PUSHED.surface, PUSHED.pose, PUSHED.velocity
        scene = build(
            surface, PARCEL, RECIPE, within=reachable(surface, PARCEL, pose, velocity, REACH)
        )
        data = mujoco.MjData(scene.model)
        supporting = elements_under(surface, PARCEL, pose)
        stiffness = RECIPE.stiffness * surface.grid.stiffness[supporting]
        sag = static_sag(np.zeros(len(stiffness)), stiffness, GRAVITY)
        half_turn = 0.5 * pose[2]
        data.qpos[:7] = pose[0], pose[1], -sag, math.cos(half_turn), 0, 0, math.sin(half_turn)
        data.qvel[:6] = velocity[0], velocity[1], 0, 0, 0, velocity[2]
        mujoco.mj_forward(scene.model, data)
        begin = time.perf_counter()
        self._model = mujoco_warp.put_model(scene.model)
        self.data = mujoco_warp.put_data(
            scene.model, data, nworld=num_envs, nconmax=MOST_CONTACTS, njmax=MOST_ROWS
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
        """Step a number of decisions; the box restarts before it leaves the modelled elements.

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

    def episodes(self) -> int:
        """Return 0, since there are no episodes."""
        return 0


def measure_warp(num_envs: int) -> Rate:
    """Measure MuJoCo Warp with a number of worlds."""
    return measure_rate(WarpScene(num_envs), WARP_EFFORT)
