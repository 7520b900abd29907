"""RLlib: it is fed what the environments show and pay, and learns."""

import math
from pathlib import Path

import numpy as np
import pytest

import surface_gym as sg
from tests.learners.runs import EXAMPLES, check_sort, run

pytest.importorskip("ray.rllib", exc_type=ImportError)  # there is Ray without RLlib, too


@pytest.fixture
def examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)


def test_it_learns(tmp_path: Path) -> None:
    check_sort(run("rllib_sort", 106_496, tmp_path), "ray")


def test_it_learns_of_agents(tmp_path: Path) -> None:
    done = run("rllib_flow", 6_000, tmp_path)
    assert all(math.isfinite(loss) for loss in done.losses)
    assert 0.0 <= done.results["left by their exit"] <= 1.0


def test_its_environments_are_those_of_the_native_vector_env() -> None:
    """Each episode that is learned from is one of a single environment."""
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

    config = (
        PPOConfig()
        .environment("SmartSurface/Sort-v0", env_config={"actions": "halves"})
        .env_runners(num_envs_per_env_runner=4, gym_env_vectorize_mode="vector_entry_point")
        .debugging(seed=0)
    )
    runner = SingleAgentEnvRunner(config=config)
    assert isinstance(runner.env.unwrapped, sg.SmartSurfaceVectorEnv)
    sampled = runner.sample(num_episodes=4, random_actions=True)
    singles = [sg.SmartSurfaceEnv("sort", actions="halves") for _ in range(4)]
    starts = {single.reset(seed=k)[0].tobytes(): single for k, single in enumerate(singles)}
    for episode in sampled:
        seen = episode.get_observations()
        single = starts.pop(seen[0].tobytes())  # any other start would be a KeyError
        steps = zip(episode.get_actions(), episode.get_rewards(), seen[1:], strict=True)
        for action, reward, after in steps:
            expected, paid, terminated, *_ = single.step(action)
            assert after.tolist() == expected.tolist()
            assert reward == pytest.approx(paid)
        assert episode.is_terminated == terminated
    runner.stop()


@pytest.mark.usefixtures("examples")
def test_agents_of_a_flow_live_in_one_stretch_each() -> None:
    """They see and are paid what the flow says, and 1 less for a jam."""
    import rllib_flow

    env, flow = rllib_flow.FlowOfAgents({}), rllib_flow.flow()
    random = np.random.default_rng(0)
    outcomes = set()
    for seed in range(6):
        seen, _ = env.reset(seed=seed)
        expected, _ = flow.reset(seed=seed)
        gone: set[str] = set()
        while flow.agents:
            assert set(seen) == set(flow.agents)
            assert not set(seen) & gone
            actions = {a: random.integers(4, size=2) if seed % 2 else (2, 2) for a in flow.agents}
            expected, paid, *ends, _ = flow.step(actions)
            seen, rewards, terminated, truncated, done = env.step(actions)
            stretch_ends = not set(actions) & set(flow.agents)
            assert terminated.pop("__all__") == stretch_ends
            assert not truncated.pop("__all__")
            assert [terminated, truncated] == [{a: end[a] for a in seen} for end in ends]
            assert set(seen) == (set(actions) if stretch_ends else set(expected))
            for agent, info in done.items():
                outcomes.add(info.get("outcome"))
                jammed = info.get("outcome") == "jam"
                assert rewards[agent] == pytest.approx(paid[agent] - jammed)
            gone |= set(actions) - set(flow.agents)
            if stretch_ends:
                seen, _ = env.reset()
            if not flow.agents:
                break
            seen = {agent: seen[agent] for agent in flow.agents}
            assert all(seen[a].tolist() == expected[a].tolist() for a in seen)
    assert {"jam", "right"} <= outcomes
