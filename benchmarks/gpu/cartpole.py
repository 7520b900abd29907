"""Beside: gymnax's CartPole, all of it compiled by JAX."""

import os
import time
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from benchmarks.gpu.windows import Effort, Rate, rate_of

GYMNAX = find_spec("gymnax") is not None


class CartPole:
    """CartPole-v1 with random actions, reset where it ends.

    Args:
        lanes: their number.
        chunk: steps that JAX compiles into one; others are multiples of it.
    """

    def __init__(self, lanes: int, chunk: int) -> None:
        # JAX would keep most of the GPU's memory for itself.
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
        gymnax, jax = import_module("gymnax"), import_module("jax")
        env, parameters = gymnax.make("CartPole-v1")
        self.lanes = lanes
        self.name = f"gymnax CartPole, {jax.devices()[0].device_kind}"

        def one(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], None]:
            key, _, state, _ = carry
            key, for_actions, for_env = jax.random.split(key, 3)
            actions = jax.random.randint(for_actions, (lanes,), 0, 2)
            stepped = jax.vmap(env.step, in_axes=(0, 0, 0, None))
            keys = jax.random.split(for_env, lanes)
            # Observation and reward are kept: JAX leaves out what nobody reads.
            observation, state, reward, *_ = stepped(keys, state, actions, parameters)
            return (key, observation, state, reward), None

        @jax.jit
        def move(carry: tuple[Any, ...]) -> tuple[Any, ...]:
            moved: tuple[Any, ...] = jax.lax.scan(one, carry, None, chunk)[0]
            return moved

        begin = time.perf_counter()
        self._block, self._move = jax.block_until_ready, move
        keys = jax.random.split(jax.random.key(1), lanes)
        observation, state = jax.vmap(env.reset, in_axes=(0, None))(keys, parameters)
        reward = jax.numpy.zeros(lanes)
        self._carry: tuple[Any, ...] = (jax.random.key(0), observation, state, reward)
        self._chunk = chunk
        self.step(chunk)
        self.first = time.perf_counter() - begin

    def step(self, steps: int) -> None:
        for _ in range(steps // self._chunk):
            self._carry = self._move(self._carry)
        self._block(self._carry)

    def begun(self) -> int:
        return 0  # not counted


def cartpole_rate(lanes: int, effort: Effort) -> Rate:
    """Steps a second of so many lanes."""
    return rate_of(CartPole(lanes, effort.chunk), effort)
