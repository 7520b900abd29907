"""Agents for the playground: their files hold the networks and the layouts, for tasks there are."""

import json

import numpy as np
import pytest

from surface_gym.agents.export.policy import network_decision, shipped
from surface_gym.agents.export.web import main
from surface_gym.agents.rules.sorting import FixedLayout
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("site")
    (made / "site.json").write_text('{"tasks": ["sort", "flow"], "agents": false}')
    main([str(made)])
    return made


def test_it_has_the_agents_of_the_site_s_tasks_that_see_what_the_page_shows(folder):
    assert json.loads((folder / "site.json").read_text())["agents"]
    agents = json.loads((folder / "agents.json").read_text())
    assert list(agents) == ["sort", "flow"]
    assert set(agents["flow"]["parcels"]) == {"event rule", "sort-ppo"}
    assert set(agents["sort"]["policies"]) == {"sort-ppo", "sort-dqn"}
    assert set(agents["sort"]["layouts"]) == {"fixed layout", "best fixed layout"}


@pytest.mark.parametrize("name", ["sort-ppo", "sort-dqn"])
def test_the_weights_are_those_of_the_policy(folder, name):
    card = json.loads((folder / "agents.json").read_text())["sort"]["policies"][name]
    weights = np.fromfile(folder / "agents.bin", "<f4").astype(np.float64)
    decision = network_decision(shipped(name))
    values = seen = np.random.default_rng(0).uniform(-1.0, 1.0, decision.features)
    for k, (inputs, outputs, place) in enumerate(card["layers"]):
        if k:
            values = np.tanh(values) if card["activation"] == "tanh" else np.maximum(values, 0.0)
        matrix = weights[place : place + inputs * outputs].reshape(outputs, inputs)
        values = matrix @ values + weights[place + matrix.size : place + matrix.size + outputs]
    assert values == pytest.approx(decision.network.scores(seen), abs=1e-12)
    assert decision.symmetry is not None
    assert card["mirror"] == decision.symmetry.images.tolist() == [0, 2, 1, 3]


def test_a_layout_is_what_the_rule_chooses_at_the_seed_s_start(folder):
    layouts = json.loads((folder / "agents.json").read_text())["sort"]["layouts"]["fixed layout"]
    env, rule = SmartSurfaceEnv("sort"), FixedLayout(EnvConfig("sort"))
    assert len(layouts) == 20
    for seed in (0, 7):
        wanted, _ = rule.predict(env.reset(seed=seed)[0])
        choices = [choice for choice, many in layouts[seed] for _ in range(many)]
        assert choices == wanted.tolist()
