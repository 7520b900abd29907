"""Formulas give what NumPy gives, in a graph and in C too."""

import numpy as np
import pytest

from agents.export.formula import (
    angle_of,
    constant,
    feature,
    limited,
    of_module,
    operation,
    reckon,
)
from agents.export.formulas_in_c import formulas_in_c
from agents.export.graph import OBSERVATION, Graph, need

TURNS = np.linspace(-np.pi, np.pi, 721)
SEEN = np.stack([np.sin(TURNS), np.cos(TURNS)], axis=1).astype(np.float32)
ALL = np.concatenate([SEEN, [[0, 0], [0, 1], [0, -1], [1, 0], [-1, 0]]]).astype(np.float32)


def test_an_angle_is_that_of_its_sine_and_cosine() -> None:
    (angle,), _ = reckon([angle_of(feature(0), feature(1))], ALL)
    doubles = ALL.astype(np.float64)
    np.testing.assert_allclose(angle[:, 0], np.arctan2(doubles[:, 0], doubles[:, 1]), atol=1e-15)


def test_a_graph_reckons_in_double_precision() -> None:
    """Though its arc tangent is of single precision."""
    onnx = pytest.importorskip("onnx", reason="onnx, of the extra `export`, is missing")
    pytest.importorskip("onnxruntime", reason="onnxruntime, of the extra `export`, is missing")
    formula = angle_of(feature(0), feature(1)) + 0.0 * of_module("y", np.arange(3.0))
    graph = Graph()
    (name,) = graph.formulas([formula])
    whole = onnx.TensorProto
    made = onnx.helper.make_graph(
        graph._nodes,
        "formula",
        [onnx.helper.make_tensor_value_info(OBSERVATION, whole.FLOAT, ["lanes", 2])],
        [onnx.helper.make_tensor_value_info(name, whole.DOUBLE, ["lanes", 3])],
        graph._constants,
    )
    model = onnx.helper.make_model(
        made, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8
    )
    session = need("onnxruntime").InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    (angle,) = session.run(None, {OBSERVATION: SEEN})
    (wanted,), _ = reckon([formula], SEEN)
    np.testing.assert_allclose(angle, wanted, atol=1e-13)


def test_doubt_is_where_a_comparison_or_a_jump_hangs_on_round_off() -> None:
    third = feature(0) / 3.0
    at_most = operation("at most", 3.0 * third, feature(1))
    seen = np.array([[0.1, 0.1], [0.1, 0.2], [0.2, 0.1]], dtype=np.float32)
    _, doubt = reckon([at_most], seen)
    assert doubt[:, 0].tolist() == [True, False, False]
    _, sure = reckon([operation("at most", feature(0), feature(1))], seen)
    assert not sure.any()  # as they are given, they have no round-off
    jumps = [operation("floor", 2.0 * feature(0)), operation("round", 1.0 * feature(0))]
    numbers = np.array([[1.0], [0.5], [0.3]], dtype=np.float32)
    assert reckon(jumps[:1], numbers)[1][:, 0].tolist() == [True, True, False]
    assert reckon(jumps[1:], numbers)[1][:, 0].tolist() == [False, True, False]


def test_limits_hold_both_ways() -> None:
    seen = np.array([[-2.0], [0.25], [7.0]], dtype=np.float32)
    (value,), _ = reckon([limited(constant(1.0) * feature(0), 0.0, 1.0)], seen)
    assert value[:, 0].tolist() == [0.0, 0.25, 1.0]


def test_in_c_what_is_one_for_all_modules_is_reckoned_once() -> None:
    offset = (0.3 * feature(0)).named("offset")
    y = of_module("y", np.array([-0.05, 0.05])) - offset
    told = formulas_in_c([operation("at most", y, 0.0)], "it")
    assert told.once == ("const double offset_3 = 0.3 * (double)observation[0];",)
    assert told.of_module == (
        "const double number_4 = it_y[module] - offset_3;",
        "const int number_6 = number_4 <= 0.0;",
    )
    assert told.results == ("number_6",)
    assert "static const double it_y[2]" in told.tables
