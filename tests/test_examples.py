"""The examples run, hold what their page promises, and are what it shows."""

import doctest
import math
import pickle
import runpy
import sys
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import surface_gym as sg
from surface_gym import agents
from surface_gym.agents import library, train_cli
from surface_gym.agents.evaluation.method import of_runs, unloaded_runs
from surface_gym.agents.learning import runs, slopes
from surface_gym.agents.learning.config import defaults
from surface_gym.agents.learning.slopes import training_configs
from surface_gym.agents.library import find_task
from surface_gym.agents.rules import find_rules
from surface_gym.extend import GYRATION, MASS
from surface_gym.tasks import Sort
from tests.docs.reading import code_blocks
from tests.environments import played_out

ROOT = Path(__file__).parent.parent
# The README and docs/agents.md show these by a few of their lines.
SHORT = {ROOT / "examples" / name for name in ("first_agent.py", "module_agent.py")}
EXAMPLES = sorted({*(ROOT / "examples").glob("*.py")} - SHORT)


@cache
def run_example(example: str) -> dict[str, Any]:
    """Return the names that an example defines."""
    return runpy.run_path(str(ROOT / "examples" / f"{example}.py"))


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_the_page_shows_it(file):
    assert ("python", file.read_text()) in code_blocks("docs/extending.md")


@pytest.mark.parametrize(
    ("example", "lines"),
    [("reach", 120), ("haste", 20), ("even", 250), ("scales", 80), ("reinforce", 125)],
)
def test_it_is_short(example, lines):
    assert len((ROOT / "examples" / f"{example}.py").read_text().splitlines()) <= lines


class TestReach:
    @pytest.fixture
    def env(self) -> sg.SmartSurfaceEnv:
        reach = find_task(f"{ROOT}/examples/reach.py:Reach")
        return sg.SmartSurfaceEnv(reach, actions="quadrants", control_period=0.02)

    def test_the_goal_is_where_and_how_it_says(self, env):
        observation, info = env.reset(seed=3, options={"heading": 0.3, "parcel": "S"})
        x, y, theta = info["pose"]
        ahead, aside = observation[0], 0.2 * observation[1]
        assert (x + ahead, theta + 0.3 * observation[3]) == pytest.approx((2.2, 0.3))
        assert abs(y + aside - 0.8) <= 0.2
        ended = False
        while not ended:
            _, _, ended, _, info = env.step([3, 3, 3, 3])  # straight on
        miss = math.hypot(2.2 - info["pose"][0], y + aside - info["pose"][1])
        assert info["miss"] == pytest.approx(miss, abs=1e-6)
        assert info["outcome"] == "passed the point"

    def test_a_parcel_sent_straight_at_it_succeeds(self, env):
        """The point lies straight ahead and the heading is that of the parcel."""
        for seed in range(400):
            observation, _ = env.reset(seed=seed, options={"heading": 0.0, "parcel": "S"})
            if abs(0.2 * observation[1]) < 0.01:
                break
        ended = False
        while not ended:
            _, _, ended, _, info = env.step([3, 3, 3, 3])
        assert info["outcome"] == "success"


EVEN = f"{ROOT}/examples/even.py:Even"


def load_even() -> dict[str, Any]:
    """Return the names in the file of Even, whose kernel all tests share."""
    return vars(sys.modules[type(find_task(EVEN)).__module__])


class TestEven:
    def test_it_is_an_environment(self):
        load_even()
        env = gym.make("Examples/Even-v0", actions="parcels", render_mode="rgb_array")
        check_env(env.unwrapped, skip_render_check=True)
        env.reset(seed=0)
        assert env.render().ndim == 3
        assert env.unwrapped.config.task_name == "even"

    def test_its_rule_is_compared_with_others(self):
        run_example("even")
        load_even()  # the file again
        (rule,) = find_rules("even")
        assert (rule.name, rule.task, rule.actions) == ("least loaded", "even", "parcels")

    def test_its_rule_loads_exits_evenly_and_rolling_on_does_not(self):
        even = load_even()
        envs = sg.SmartSurfaceVectorEnv(2, even["Even"](), actions="parcels")
        straight = np.full(envs.action_space.shape, 3)
        for controller, correct in ((even["LeastLoaded"](envs.config), (8, 8)), (None, (2, 2))):
            observations, _ = envs.reset(seed=0)
            ended = np.zeros(2, dtype=bool)
            while not ended.any():
                actions = controller.predict(observations)[0] if controller else straight
                observations, _, _, ended, infos = envs.step(actions)
            assert tuple(infos["correct"]) == correct
            assert (infos["wrong"] > 0).any() == (controller is None)


def test_haste_rewards_early_success():
    haste = run_example("haste")["Haste"]()
    assert isinstance(haste, Sort)
    env = sg.SmartSurfaceEnv(haste, actions="halves")
    played = played_out(env, 2 * 4 + 2, speed=1.5, parcel="S", side=1)
    rewards, info = [step[1] for step in played], played[-1][4]
    assert info["outcome"] == "success"
    assert rewards == [0.0] * (len(rewards) - 1) + [pytest.approx(1.0 + 0.5 / info["time"])]


@pytest.mark.parametrize("example", ["ruled", "scales"])
def test_its_docstring_runs(example):
    names = run_example(example)
    text = doctest.DocTestParser().get_doctest(names["__doc__"], names, example, None, 0)
    assert len(text.examples) > 2
    assert doctest.DocTestRunner().run(text).failed == 0


class TestScales:
    def test_they_show_what_they_weighed_once_beside_all_else(self):
        scales = run_example("scales")["Scales"](error=0.5)
        observe = ("parcel", "weight")
        env = sg.SmartSurfaceEnv("sort", sensors=scales, observe=observe, actions="halves")
        exact = sg.SmartSurfaceEnv("sort", observe=("parcel",), actions="halves")
        weighed = set()
        for seed in range(6):
            shown, _ = env.reset(seed=seed)
            body, mass = env.batch.view(0).body, 10.0 * float(shown[-2])
            weighed.add(mass - body[MASS])
            assert shown[-1] == pytest.approx(mass * body[GYRATION], rel=1e-5)
            np.testing.assert_array_equal(shown[:-2], exact.reset(seed=seed)[0])
            shown, _, _, _, _ = env.step(3)
            assert 10.0 * float(shown[-2]) == mass
            np.testing.assert_array_equal(shown[:-2], exact.step(3)[0])
        assert len(weighed) == 6
        assert 0.1 < np.std(list(weighed)) < 1.0

    def test_only_their_environment_offers_the_group(self):
        with pytest.raises(ValueError, match="observe must be one of 'parcel', 'rotors', 'load'"):
            sg.SmartSurfaceEnv("sort", observe=("weight",))


class TestRuled:
    def test_it_sees_the_nearest_line_and_the_mean_velocity_since(self):
        ruled = run_example("ruled")["Ruled"](line=0.02, turn=0.05)
        env = sg.SmartSurfaceEnv("sort", sensors=ruled)
        env.reset(seed=0, options={"speed": 1.5, "parcel": "B", "side": 1})
        env.action_space.seed(0)
        state = env.batch.view(0)
        seen = [state.sensed.copy()]
        for _ in range(12):
            if env.step(env.action_space.sample())[2]:
                break
            units = np.array([0.02, 0.02, 0.05])
            nearest = units * np.round(state.truth[:3] / units)
            np.testing.assert_allclose(state.sensed[:3], nearest, atol=1e-12)
            mean = (state.sensed[:3] - seen[-1][:3]) / 0.04
            np.testing.assert_allclose(state.sensed[3:], mean, atol=1e-9)
            seen.append(state.sensed.copy())
        assert len(seen) > 8


def test_the_checkered_line_sorts_and_is_drawn(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_example("checkered")["main"]()
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("S-box: success after")
    assert printed[1].startswith("B-box: success after")
    assert (tmp_path / "checkered.png").read_bytes().startswith(b"\x89PNG")


class TestReinforce:
    ALGO = f"{ROOT}/examples/reinforce.py:REINFORCE"
    OPTIONS = f"--task sort --algo {ALGO} --steps 600 --num-envs 4 --n-steps 20".split()

    @pytest.fixture
    def run(self, tmp_path: Path) -> Path:
        options = (*self.OPTIONS, "--checkpoint-every", "200", "--out", str(tmp_path))
        config = train_cli.parse_arguments(options).config
        assert config is not None
        folder = runs.make_folder(config, options)
        assert not runs.train(config, folder).interrupted
        return folder

    def test_its_policy_is_read_back_and_acts(self, run):
        assert run.name.startswith("sort-reinforce-seed0-")
        policy = agents.read(run)
        assert policy.card.algo == "Own/REINFORCE"
        env = gym.make(policy.env_id, **policy.env_kwargs)
        observation, _ = env.reset(seed=0)
        for deterministic in (True, False):
            assert policy.predict(observation, deterministic=deterministic)[0] in env.action_space

    def test_an_interrupted_run_is_resumed_to_the_same_result(self, run, tmp_path):
        broken = tmp_path / "broken"
        broken.mkdir()
        config = runs.read_config(run / runs.CONFIG, algo=self.ALGO)

        def interrupt(steps: int, _success: float) -> None:
            if steps > 300:
                raise runs.StopTraining

        assert runs.train(config, broken, interrupt).interrupted
        runs.train(config, broken)
        assert (broken / library.WEIGHTS).read_bytes() == (run / library.WEIGHTS).read_bytes()

    def test_it_is_compared_if_its_file_is_named(self, run, monkeypatch):
        assert [each.seeds for each in of_runs("sort", run.parent)] == [(0,)]
        assert unloaded_runs("sort", run.parent) == {}
        monkeypatch.delitem(library.ALGORITHMS._values, "Own/REINFORCE")
        assert of_runs("sort", run.parent) == []
        assert unloaded_runs("sort", run.parent) == {run: self.ALGO}
        monkeypatch.setattr(library, "_NAMED", [])
        with pytest.raises(ValueError, match=r"algo must be loaded .*file\.py:REINFORCE"):
            agents.read(run)

    def test_its_file_must_be_named_by_the_user(self, run, monkeypatch):
        monkeypatch.setattr(library, "_NAMED", [])
        with pytest.raises(ValueError, match=r"algo must be .*: name it by --algo, got None"):
            runs.read_config(run / runs.CONFIG)
        config = train_cli.parse_arguments(("--resume", str(run), "--algo", self.ALGO)).config
        assert config == pickle.loads(pickle.dumps(config))  # by its file, in any process
        assert config is not None
        assert config.hidden == defaults("sort", self.ALGO).hidden
        with pytest.raises(ValueError, match=r"algo must be an Algorithm in .*, got 'train'"):
            library.find_algorithm(self.ALGO.replace("REINFORCE", "train"))


def test_a_task_on_streams_is_learned_without_a_rule(tmp_path, monkeypatch):
    # With exact sensors, as the other tests: the lab's would compile a kernel of their own.
    monkeypatch.setattr(slopes, "training_configs", lambda each: training_configs(each)[-1:])
    options = "--num-envs 6 --n-steps 8 --steps 96 --hidden 8 --batch-size 48 --n-epochs 1"
    config = train_cli.parse_arguments(["--task", EVEN, *options.split()]).config
    assert config is not None
    assert config.algo == "parcels"
    assert runs.train(config, tmp_path).steps == 96
    even = find_task(config.task)
    policy = agents.read(tmp_path, even)
    env = gym.make("SmartSurface/Flow-v0", **policy.env_kwargs)
    observation, _ = env.reset(seed=0)
    assert policy.predict(observation)[0] in env.action_space


@pytest.mark.parametrize("num_envs", ["1", "2"])
def test_the_first_agent_learns_by_one_command(num_envs, monkeypatch, capsys):
    from examples import first_agent

    monkeypatch.setattr(first_agent, "EPISODES", 2)
    monkeypatch.setattr("sys.argv", ["first_agent.py", "--steps", "1", "--num-envs", num_envs])
    first_agent.main()
    assert " of 2 episodes" in capsys.readouterr().out
