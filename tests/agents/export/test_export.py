"""An export decides as the policy does, whatever its task, actions and networks; mistakes are
found, and kept apart from ties.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from torch import nn

from surface_gym import agents
from surface_gym.agents.export import check, policy
from surface_gym.agents.export import onnx as graphs
from surface_gym.agents.export.c_header import make_header
from surface_gym.agents.export.check import compare, random_observations
from surface_gym.agents.export.cli import make_model
from surface_gym.agents.export.policy import NetworkDecision, network_decision, shipped
from tests.agents.export.made import CARDS, count_of_each, made, wanted

SHIPPED = [name for name in agents.names() if name != "flow-ppo"]


COUNT = 1000
ONNX_NEEDED = ("onnx", "onnxruntime")


@pytest.mark.parametrize("name", [*SHIPPED, *CARDS])
def test_it_decides_as_the_policy(name) -> None:
    source = made(name) if name in CARDS else shipped(name)
    is_modules = source.policy.card.algo == "modules"
    decision = graphs.modules_decision(source) if is_modules else network_decision(source)
    seen = random_observations(source, COUNT, seed=1)
    if name in CARDS:  # they ask for every choice: else the comparison would say little
        assert min(count_of_each(wanted(source, seen))) > 10
        names = [each.name for each in source.config.features]
        if "side" in names:
            assert {-1.0, 0.0, 1.0} <= set(seen[:, names.index("side")].tolist())
    compiler = check.find_compiler()
    if isinstance(decision, NetworkDecision) and compiler is not None:
        header = make_header(decision, name, source.config.control_period, {"of": "a */ test"})
        decide = check.run_c(compiler, header, name, decision.parts)
        assert compare("C", decision, source, seen, decide).observations == COUNT
    for library in ONNX_NEEDED:
        pytest.importorskip(library, reason=f"{library}, of the extra `export`, is missing")
    decide = check.run_onnx(make_model(decision, {}))
    agreement = compare("ONNX", decision, source, seen, decide)
    assert agreement.observations == COUNT
    assert agreement.close < 0.01 * COUNT * agreement.parts
    choices, angles = decide(seen)
    assert angles.shape == choices.shape == (COUNT, decision.parts)
    # Parcels do not mix.
    np.testing.assert_array_equal(decide(seen[7:8])[0], choices[7:8])


@pytest.mark.skipif(check.find_compiler() is None, reason="there is no C compiler")
def test_a_header_that_does_not_compile_is_refused() -> None:
    source, compiler = made("quadrants"), check.find_compiler()
    decision = network_decision(source)
    header = make_header(decision, "quadrants", 0.05, {}).replace("#include <math.h>", "")
    seen = random_observations(source, 4, seed=0)
    with pytest.raises(ValueError, match="header must compile without a warning"):
        check.run_c(compiler, header, "quadrants", decision.parts)(seen)


TURNS = np.linspace(-np.pi, np.pi, 721)
SEEN = np.stack([np.sin(TURNS), np.cos(TURNS)], axis=1).astype(np.float32)


def test_an_angle_is_that_of_its_sine_and_cosine() -> None:
    exact = [[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]]
    sine, cosine = np.concatenate([SEEN, exact]).astype(np.float32).astype(np.float64).T
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = graphs._angle(graphs.Watched(sine, []), graphs.Watched(cosine, [])).value
    np.testing.assert_allclose(angle, np.arctan2(sine, cosine), atol=1e-15)


def test_a_graph_computes_in_double_precision_what_numpy_does() -> None:
    """Though its arc tangent is of single precision."""
    for library in ONNX_NEEDED:
        pytest.importorskip(library, reason=f"{library}, of the extra `export`, is missing")
    import onnx

    graph, kinds, helper = graphs.Graph(), onnx.TensorProto, onnx.helper
    traced: graphs.Traced = graphs._angle(*graph.features(2)) + np.zeros((1, 3))
    given = helper.make_tensor_value_info(graphs.OBSERVATION, kinds.FLOAT, ["num_envs", 2])
    result = helper.make_tensor_value_info(traced.name, kinds.DOUBLE, ["num_envs", 3])
    whole = helper.make_graph(graph._nodes, "angle", [given], [result], graph._constants)
    model = helper.make_model(whole, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    session = graphs.need("onnxruntime").InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    (angle,) = session.run(None, {graphs.OBSERVATION: SEEN})
    sine, cosine = SEEN.astype(np.float64).T
    wanted = np.repeat(np.arctan2(sine, cosine)[:, np.newaxis], 3, axis=1)
    np.testing.assert_allclose(angle, wanted, atol=1e-13)


def test_doubt_is_where_a_comparison_or_a_jump_hangs_on_round_off() -> None:
    doubts: list[np.ndarray] = []
    first, second = np.array([0.1, 0.1, 0.2]), np.array([0.1, 0.2, 0.1])
    _ = graphs.Watched(first, doubts) <= graphs.Watched(second, doubts)
    assert doubts.pop().tolist() == [True, False, False]
    _ = graphs.Watched(first, doubts, exact=True) <= graphs.Watched(second, doubts, exact=True)
    assert not doubts  # as they are given, they have no round-off
    numbers = graphs.Watched(np.array([1.0, 0.5, 0.3]), doubts)
    np.floor(2.0 * numbers)
    assert doubts.pop().tolist() == [True, True, False]
    np.rint(numbers)
    assert doubts.pop().tolist() == [False, True, False]


@pytest.fixture
def stop() -> policy.Source:
    return made("stop")


def deciding(
    choices: policy.Integers, source: policy.Source
) -> Callable[[policy.Singles], tuple[policy.Integers, policy.Numbers]]:
    angles: policy.Numbers = np.array(source.config.chosen_orientations)
    return lambda _: (choices, angles[choices])


def test_another_choice_and_another_angle_are_errors_that_name_it(stop) -> None:
    seen, decision = random_observations(stop, 200, seed=0), policy.network_decision(stop)
    choices = wanted(stop, seen)
    angles = choices.astype(np.float64)
    with pytest.raises(ValueError, match="must give the angles of what it chooses"):
        compare("it", decision, stop, seen, lambda _: (choices, angles))
    choices[13, 1] = (choices[13, 1] + 1) % 4
    with pytest.raises(ValueError, match="must decide as the policy of stop does, got 1 of 200"):
        compare("it", decision, stop, seen, deciding(choices, stop))


def test_ties_are_counted_apart_but_not_without_limit(stop) -> None:
    """With all scores the same, so that any decision is right."""
    decision = policy.network_decision(stop)
    *first, last = decision.network.layers
    flat = replace(last, weights=np.zeros_like(last.weights), bias=np.zeros_like(last.bias))
    decision = replace(decision, network=replace(decision.network, layers=(*first, flat)))
    seen = random_observations(stop, 200, seed=0)
    choices = wanted(stop, seen)
    agreement = compare("it", decision, stop, seen, deciding(choices, stop))
    assert (agreement.ties, agreement.close) == (0, 400)
    choices[13, 1] = (choices[13, 1] + 1) % 4
    agreement = compare("it", decision, stop, seen, deciding(choices, stop))
    assert agreement.ties == 1
    assert "1 of them otherwise, all ties" in agreement.summary()
    with pytest.raises(ValueError, match="though all where scores are close"):
        compare("it", decision, stop, seen, deciding((choices + 1) % 4, stop))


def test_a_network_of_another_kind_is_refused() -> None:
    for modules in (
        nn.Sequential(nn.Linear(2, 2), nn.Sigmoid(), nn.Linear(2, 2)),
        nn.Sequential(nn.Linear(2, 2), nn.Tanh()),
        nn.Sequential(nn.Linear(2, 2), nn.Tanh(), nn.Linear(2, 2), nn.ReLU(), nn.Linear(2, 2)),
    ):
        with pytest.raises(ValueError, match="network must be linear layers"):
            policy.read_network(modules)
