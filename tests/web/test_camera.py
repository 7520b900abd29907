"""A camera in the page: it draws NumPy's noise, and what it senses is what Python's does."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import surface_gym
from surface_gym.agents import library
from surface_gym.agents.export.web import write_agents
from surface_gym.agents.rules.sorting import StreamEventRule
from surface_gym.compiler.random import EDGE
from surface_gym.config import EnvConfig
from surface_gym.registration import env_id
from surface_gym.sensors import Camera
from surface_gym.state import NOISE_ROWS
from surface_gym.web.scene import TaskScene
from surface_gym.web.starts import write_state
from tests.web.conftest import (
    Site,
    check_script,
    end_in_page,
    end_in_python,
    end_states,
    open_sort,
    wait_for,
)

assert surface_gym
TIMES = 200  # so that some ten of the normal numbers lie beyond the last layer
STREAM_PERIODS = 200  # in which all rows of noise of a parcel are used up, and drawn anew


@pytest.fixture
def filmed(site: Site, play: Any) -> Any:
    """Open the playground at a scene with a camera, in which agents may act."""

    def opened(scene: TaskScene) -> Any:
        site.add("sort", scene.task, f"{scene.task}-camera")
        if scene.agent != "you":
            write_agents(site.folder)
        page = play(address=scene.url())
        wait_for(page, f"playground.shown[0].name === '{scene.agent}'")
        return page

    return opened


def test_numbers_are_those_that_numpy_draws(site, play):
    site.add("noise")
    page = play()
    generator = np.random.default_rng(7)
    state = write_state(generator)
    found = page.evaluate(
        """async ([state, times]) => {
          const { Machine } = await import("./machine.js");
          const machine = await Machine.load("noise");
          machine.view("words").set(state.map((word) => BigInt(`0x${word}`)));
          return Array.from({ length: times }, () => {
            machine.step();
            return [...machine.view("noise")];
          });
        }""",
        [state, TIMES],
    )
    noise = np.array(found).reshape(TIMES, NOISE_ROWS, 4)
    for each in noise:
        np.testing.assert_array_equal(each[:, :3], generator.standard_normal((NOISE_ROWS, 3)))
        np.testing.assert_array_equal(each[:, 3], generator.random(NOISE_ROWS))
    assert np.abs(noise).max() > EDGE


@pytest.mark.parametrize("task", ["sort", "orient"])
def test_an_episode_is_sensed_as_in_python(filmed, task):
    page = filmed(TaskScene(task, seed=4, camera=True))
    env = gym.make(env_id(task), sensors=Camera())
    env.reset(seed=4)
    batch = env.unwrapped.batch
    random, over, apart = np.random.default_rng(0), False, 0.0
    while not over:
        action = np.full(env.action_space.shape, random.integers(4))
        *_, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
        sensed = page.evaluate(
            """(choice) => {
              const { run } = playground.shown[0];
              run.wanted.fill(choice);
              run.advance();
              return [...run.machine.view("parcels.sensed")];
            }""",
            int(action.flat[0]),
        )
        assert sensed == batch.parcels.sensed[0].tolist()
        apart = max(apart, abs(sensed[0] - batch.parcels.truth[0, 0]))
    assert page.evaluate("playground.shown[0].run.over")
    assert apart > 1e-5


def test_a_stream_is_sensed_as_in_python(filmed):
    page = filmed(TaskScene("flow", seed=2, agent="event rule", camera=True))
    env = gym.make(env_id("flow"), actions="parcels", sensors=Camera())
    rule = StreamEventRule(EnvConfig("flow", actions="parcels", sensors=Camera()))
    table, _ = env.reset(seed=2)
    batch = env.unwrapped.batch
    expected = []
    for _ in range(STREAM_PERIODS):
        table = env.step(rule.predict(table)[0])[0]
        expected.append(batch.parcels.sensed[batch.streams.present[0]].ravel().tolist())
    found = page.evaluate(
        """(periods) => {
          const { run } = playground.shown[0];
          return Array.from({ length: periods }, () => {
            run.advance();
            const there = run.machine.view("streams.present");
            const sensed = [...run.machine.view("parcels.sensed")];
            return sensed.filter((_, k) => there[Math.floor(k / 6)]);
          });
        }""",
        STREAM_PERIODS,
    )
    assert found == expected
    assert sum(map(bool, expected)) > STREAM_PERIODS / 2


def test_a_policy_acts_on_what_the_camera_sees(filmed):
    page = filmed(TaskScene("sort", agent="sort-ppo", camera=True))
    env = gym.make(env_id("sort"), actions="halves", sensors=Camera())
    policy = library.load("sort-ppo")
    for seed in (0, 1, 5):
        assert end_in_page(page, "sort-ppo", seed) == end_in_python(env, policy, seed)


def test_the_switch_puts_a_camera_there_and_takes_it_away(play):
    site_with_one = play("sort-camera", "slow")
    site_with_one.context.close()
    page = open_sort(play)
    page.select_option("#agent", "all at 45°")
    exact = end_states(page)
    page.check("#camera")
    wait_for(page, "playground.scene.camera")
    assert end_states(page) == exact  # who acts looks at nothing
    frame = "playground.shown[0].run.frame().parcels[0]"
    (x, y, _), truth = page.evaluate(f"[{frame}.sensed, [{frame}.x, {frame}.y]]")
    assert 0.0 < np.hypot(x - truth[0], y - truth[1]) < 0.02
    check_script(page)
    page.click("#again")
    assert end_states(page) == exact  # the same noise again
    page.uncheck("#camera")
    wait_for(page, "!playground.scene.camera")
    assert page.evaluate(f"{frame}.sensed === undefined")
    # Other tests may have put a camera there.
    page.evaluate(
        "playground.modules = playground.modules.filter((name) => name !== 'slow-camera')"
    )
    page.select_option("#task", "slow")
    wait_for(page, "playground.scene.task === 'slow'")
    assert page.is_disabled("#camera")
    page.evaluate("address => { location.hash = address }", TaskScene("slow", camera=True).url(""))
    wait_for(page, "document.getElementById('message').textContent")
    assert "has no camera for the task slow" in page.inner_text("#message")
