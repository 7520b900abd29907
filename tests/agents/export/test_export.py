"""An export decides as its policy does, mistakes are found; the command writes what it tried."""

import json
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from torch import nn

from surface_gym import agents
from surface_gym.agents.export import check, policy
from surface_gym.agents.export.check import compare, make_page, random_observations
from surface_gym.agents.export.cli import ExportConfig, export, main, make_metadata
from surface_gym.agents.export.onnx import make_model
from surface_gym.agents.learning.algorithms import PPOConfig
from surface_gym.agents.learning.runs import write_config
from surface_gym.agents.library import PolicyCard, save_policy
from tests.agents.test_policy import policy_of
from tests.environments import ON_SLOPES

OBSERVED = ("parcel", "rotors")
CARDS = {
    "quadrants": PolicyCard(
        "SmartSurface/Sort-v0", "ppo", "quadrants", 0.08, (24, 16, 8), OBSERVED
    ),
    "window": PolicyCard("SmartSurface/Sort-v0", "ppo", "window", 0.04, (12,)),
    "stop": PolicyCard("SmartSurface/Stop-v0", "dqn", "halves", 0.05, (32, 8), ("parcel",)),
}


def made(name: str) -> policy.Source:
    made, config = policy_of(CARDS[name]), CARDS[name].env_config()
    training = policy.Training("nominal")
    return policy.Source(name, 0, made, config, made._network.state_dict(), "none", training)


def wanted(source: policy.Source, observations: policy.Singles) -> policy.Integers:
    actions, _ = source.policy.predict(observations)
    chosen: policy.Integers = source.config.action_kind.commands(actions, len(observations))
    return chosen


OF_STREAMS = ("flow", *ON_SLOPES)
SHIPPED = [
    name
    for name in agents.names()
    if name.split("-")[0] not in OF_STREAMS and name != "sort-modules"
]
COUNT = 1000


def needed(*libraries: str) -> list[Any]:
    """Libraries of the extra `export`; without them a test is skipped."""
    return [
        pytest.importorskip(name, reason=f"{name}, of the extra `export`, is missing")
        for name in libraries
    ]


@pytest.mark.parametrize("name", [*SHIPPED, *CARDS])
def test_it_decides_as_the_policy(name) -> None:
    source = made(name) if name in CARDS else policy.shipped(name)
    decision = policy.network_decision(source)
    seen = random_observations(source, COUNT, seed=1)
    if name in CARDS:  # they ask for every choice: else the comparison would say little
        assert np.bincount(wanted(source, seen).ravel(), minlength=4).min() > 10
        names = [each.name for each in source.config.features]
        if "side" in names:
            assert {-1.0, 0.0, 1.0} <= set(seen[:, names.index("side")].tolist())
    needed("onnx", "onnxruntime")
    decide = check.run_onnx(make_model(decision, {}))
    agreement = compare(decision, source, seen, decide)
    assert agreement.observations == COUNT
    assert agreement.close < 0.01 * COUNT * agreement.parts
    choices, angles = decide(seen)
    assert angles.shape == choices.shape == (COUNT, decision.parts)
    # Parcels do not mix.
    np.testing.assert_array_equal(decide(seen[7:8])[0], choices[7:8])


CPU = ["CPUExecutionProvider"]


@pytest.fixture
def stop() -> policy.Source:
    return made("stop")


def deciding(choices: policy.Integers, source: policy.Source) -> Any:
    angles = np.array(source.config.chosen_orientations)[choices]
    return lambda _: (choices, angles)


def test_another_choice_and_another_angle_are_errors_that_name_it(stop) -> None:
    seen, decision = random_observations(stop, 200, seed=0), policy.network_decision(stop)
    choices = wanted(stop, seen)
    angles = choices.astype(np.float64)
    with pytest.raises(ValueError, match="must give the angles of what it chooses"):
        compare(decision, stop, seen, lambda _: (choices, angles))
    choices[13, 1] = (choices[13, 1] + 1) % 4
    with pytest.raises(ValueError, match="must decide as the policy of stop does, got 1 of 200"):
        compare(decision, stop, seen, deciding(choices, stop))


def test_ties_are_counted_apart_but_not_without_limit(stop) -> None:
    decision = policy.network_decision(stop)
    *first, last = decision.network.layers
    flat = replace(last, weights=np.zeros_like(last.weights), bias=np.zeros_like(last.bias))
    decision = replace(decision, network=replace(decision.network, layers=(*first, flat)))
    seen = random_observations(stop, 200, seed=0)
    choices = wanted(stop, seen)
    agreement = compare(decision, stop, seen, deciding(choices, stop))
    assert (agreement.ties, agreement.close) == (0, 400)
    choices[13, 1] = (choices[13, 1] + 1) % 4
    agreement = compare(decision, stop, seen, deciding(choices, stop))
    assert agreement.ties == 1
    assert "1 of them otherwise, all ties" in agreement.summary()
    with pytest.raises(ValueError, match="though all where scores are close"):
        compare(decision, stop, seen, deciding((choices + 1) % 4, stop))


@pytest.mark.parametrize(
    "between",
    [(nn.Sigmoid(), nn.Linear(2, 2)), (nn.Tanh(),), (nn.Tanh(), nn.Linear(2, 2), nn.ReLU())],
)
def test_a_network_of_another_kind_is_refused(between) -> None:
    with pytest.raises(ValueError, match="network must be linear layers"):
        policy.read_network(nn.Sequential(nn.Linear(2, 2), *between))


def test_it_writes_two_files_that_it_has_checked(tmp_path, capsys) -> None:
    onnx, runtime = needed("onnx", "onnxruntime")
    main(["sort-ppo", "--seed", "1", "--out", str(tmp_path), "--observations", "400"])
    printed = "".join(capsys.readouterr().out.split())
    assert "ONNX:400observations,800choices:thesame" in printed
    names = {file.name for file in tmp_path.iterdir()}
    assert names == {"sort-ppo.onnx", "sort-ppo.md"}
    model = onnx.load(tmp_path / "sort-ppo.onnx")
    says = {each.key: each.value for each in model.metadata_props}
    source = policy.shipped("sort-ppo", 1)
    assert says == make_metadata(source)
    assert (says["agent"], says["seed"], says["control_period"]) == ("sort-ppo", "1", "0.04")
    assert json.loads(says["orientations"]) == list(source.config.chosen_orientations)
    assert json.loads(says["features"])[14] == "side"
    assert source.digest in (tmp_path / "sort-ppo.md").read_text()
    assert [each.version for each in model.opset_import] == [17]
    session = runtime.InferenceSession(tmp_path / "sort-ppo.onnx", providers=CPU)
    (value,) = session.get_inputs()
    found = (value.name, value.shape, value.type)
    assert found == ("observation", ["num_envs", 15], "tensor(float)")
    outputs = {each.name: each.type for each in session.get_outputs()}
    assert outputs == {"choices": "tensor(int64)", "angles": "tensor(double)"}


def test_a_run_is_exported_under_its_own_name_or_another(tmp_path) -> None:
    save_policy(made("window").policy._network.state_dict(), CARDS["window"], tmp_path / "window")
    folder = tmp_path / "window"
    source = policy.of_run(folder, "mine")
    assert (source.name, source.seed, source.training.preset) == ("mine", 0, "nominal")
    assert policy.of_run(folder).name == "window"
    write_config(PPOConfig(preset="lab"), folder / "config.yaml")
    presets = [each.name for each in policy.of_run(folder).training.presets]
    assert presets == list(policy.TRAINED_IN["lab"])
    command = "python train.py --preset lab"
    (folder / "card.yaml").write_text(f"command: {command}\nresults: {{}}\n")
    training = policy.of_run(folder).training
    assert (training.preset, training.command) == ("lab", command)
    with pytest.raises(ValueError, match="seed must be one of 0, got 3"):
        policy.of_run(folder, seed=3)


@pytest.mark.parametrize("name", CARDS)
def test_the_page_lists_every_feature_and_angle(name) -> None:
    source = made(name)
    page = make_page(source, make_metadata(source), check.Agreement(400, 2, 0, 1))
    for each in source.config.features:
        assert f"| {each.name} | {each.low:g} | {each.high:g} | {each.meaning} |" in page
    for angle in source.config.chosen_orientations:
        assert f"| {angle:.9g} | {np.degrees(angle):g} |" in page
    assert f"every {source.config.control_period * 1e3:g} ms" in page
    assert "400 observations, 800 choices: the same (1 too close" in page
    assert ("shown in a mirror" in page) == (source.config.task_name == "sort")


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"name": "juggle-ppo"}, r"name must be one of 'flow-schedule', .*, got 'juggle-ppo'"),
        ({}, "name must be one of .*, got None"),
        ({"name": "sort-ppo", "task": "mine.py:Mine"}, "task must stand beside --run"),
        ({"name": "sort-ppo", "observations": 3}, "observations must be .* at least 100"),
    ],
)
def test_what_is_no_export_is_refused(given, named) -> None:
    with pytest.raises(ValueError, match=named):
        ExportConfig(**given)


def test_what_cannot_be_exported_is_refused(tmp_path) -> None:
    with pytest.raises(ValueError, match="preset must be one of"):
        _ = policy.Training("weather").presets
    for name, said in (
        ("flow-schedule", "single"), ("merge-local", "single"), ("sort-modules", "PPO or DQN"),
    ):  # fmt: skip
        with pytest.raises(SystemExit, match=f"error: name must be an agent of {said}"):
            main([name, "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit, match="holds no policy"):
        main(["--run", str(tmp_path), "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()


def test_a_missing_library_is_reported_with_the_extra_that_brings_it(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    wanted = r"needs onnx, .*'surface_gym\[agents,export\]'"
    source = policy.shipped("sort-ppo")
    with pytest.raises(ImportError, match=wanted):
        make_model(policy.network_decision(source), {})
    with pytest.raises(ImportError, match=wanted):
        export(source, tmp_path)
    with pytest.raises(SystemExit, match=wanted):
        main(["sort-ppo", "--out", str(tmp_path)])
    assert list(tmp_path.iterdir()) == []
