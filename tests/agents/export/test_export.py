"""An export decides as the policy does, whatever its task, actions and networks."""

import numpy as np
import pytest

from surface_gym import agents
from surface_gym.agents.export import check
from surface_gym.agents.export import onnx as graphs
from surface_gym.agents.export.c_header import make_header
from surface_gym.agents.export.cli import make_model
from surface_gym.agents.export.policy import NetworkDecision, Source, network_decision, shipped
from tests.agents.export.made import CARDS, count_of_each, made, wanted

COUNT = 1000
SHIPPED = [name for name in agents.names() if name != "flow-ppo"]


def source_of(name: str) -> Source:
    return made(name) if name in CARDS else shipped(name)


@pytest.mark.parametrize("name", [*SHIPPED, *CARDS])
def test_it_decides_as_the_policy(name) -> None:
    source = source_of(name)
    is_modules = source.policy.card.algo == "modules"
    decision = graphs.modules_decision(source) if is_modules else network_decision(source)
    seen = check.random_observations(source, COUNT, seed=1)
    compiler = check.find_compiler()
    if isinstance(decision, NetworkDecision) and compiler is not None:
        header = make_header(decision, name, source.config.control_period, {"of": "a */ test"})
        decide = check.run_c(compiler, header, name, decision.parts)
        assert check.compare("C", decision, source, seen, decide).observations == COUNT
    pytest.importorskip("onnx", reason="onnx, of the extra `export`, is missing")
    pytest.importorskip("onnxruntime", reason="onnxruntime, of the extra `export`, is missing")
    decide = check.run_onnx(make_model(decision, {}))
    agreement = check.compare("ONNX", decision, source, seen, decide)
    assert agreement.observations == COUNT
    assert agreement.close < 0.01 * COUNT * agreement.parts
    choices, angles = decide(seen)
    assert angles.shape == choices.shape == (COUNT, decision.parts)
    # Parcels do not mix.
    np.testing.assert_array_equal(decide(seen[7:8])[0], choices[7:8])


@pytest.mark.parametrize("name", CARDS)
def test_random_observations_ask_for_every_choice(name) -> None:
    """Else a comparison would say little."""
    source = made(name)
    seen = check.random_observations(source, COUNT, seed=0)
    assert min(count_of_each(wanted(source, seen))) > 10
    names = [each.name for each in source.config.features]
    if "side" in names:
        assert {-1.0, 0.0, 1.0} <= set(seen[:, names.index("side")].tolist())


def test_a_header_that_does_not_compile_is_refused() -> None:
    compiler = check.find_compiler()
    if compiler is None:
        pytest.skip("there is no C compiler")
    source = made("quadrants")
    decision = network_decision(source)
    header = make_header(decision, "quadrants", 0.05, {}).replace("#include <math.h>", "")
    with pytest.raises(ValueError, match="header must compile without a warning"):
        check.run_c(compiler, header, "quadrants", decision.parts)(
            check.random_observations(source, 4, seed=0)
        )


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
    onnx = pytest.importorskip("onnx", reason="onnx, of the extra `export`, is missing")
    pytest.importorskip("onnxruntime", reason="onnxruntime, of the extra `export`, is missing")
    graph = graphs.Graph()
    traced: graphs.Traced = graphs._angle(*graph.features(2)) + np.zeros((1, 3))
    kinds = onnx.TensorProto
    made = onnx.helper.make_graph(
        graph._nodes,
        "angle",
        [onnx.helper.make_tensor_value_info(graphs.OBSERVATION, kinds.FLOAT, ["num_envs", 2])],
        [onnx.helper.make_tensor_value_info(traced.name, kinds.DOUBLE, ["num_envs", 3])],
        graph._constants,
    )
    model = onnx.helper.make_model(
        made, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8
    )
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
