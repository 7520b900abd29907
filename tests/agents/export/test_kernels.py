"""Kernels compiled beforehand: which there are, and that they give the same states."""

import os
import subprocess
import sys
from functools import partial

import pytest

from surface_gym.agents import library
from surface_gym.agents.export import kernels
from surface_gym.agents.rules.base import RULES
from surface_gym.compiler.jit import find_baseline
from surface_gym.registration import SHIPPED

STATES = """
import gymnasium, numpy, surface_gym
env = gymnasium.make("SmartSurface/{}-v0")
env.action_space.seed(1)
env.reset(seed=1)
for _ in range(20):
    print(env.step(env.action_space.sample())[0].tobytes().hex())
"""


def test_every_task_and_every_agent_is_compiled() -> None:
    jobs = [job for job in kernels.list_jobs() if isinstance(job, partial)]
    assert [job.args[0] for job in jobs if job.func is kernels.compile_task] == list(SHIPPED)
    compiled = [job for job in jobs if job.func is kernels.compile_method]
    assert len(compiled) >= len(library.names()) + len(RULES)


@pytest.mark.parametrize("task", ["Slow", "Singulate"])
def test_states_are_equal_to_the_bit_on_the_baseline(task: str) -> None:
    """`surface-gym compile` compiles for fewer instructions than this processor has."""
    baseline = find_baseline()
    assert baseline is not None
    fewer = {kernels.PROCESSOR: baseline.name, kernels.FEATURES: ""}
    command = [sys.executable, "-W", "error", "-c", STATES.format(task)]
    here, there = (
        subprocess.check_output(command, env={**os.environ, **more}) for more in ({}, fewer)
    )
    assert here == there
