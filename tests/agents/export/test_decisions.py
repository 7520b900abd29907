"""What is exported decides as the policy does, whatever its task, actions and networks."""

import numpy as np
import pytest

import agents
from agents.export.checking import compare, onnx_decisions
from agents.export.compiling import compiled_decisions, compiler
from agents.export.header import header_of
from agents.export.observations import at_random
from agents.export.source import Source, shipped
from agents.export.writing import decision_of, model_of
from tests.agents.export.made import CARDS, count_of_each, made, wanted

COUNT = 1000
SHIPPED = [name for name in agents.names() if name != "flow-ppo"]


def source_of(name: str) -> Source:
    return made(name) if name in CARDS else shipped(name)


@pytest.mark.parametrize("name", [*SHIPPED, *CARDS])
class TestEach:
    def test_a_graph_decides_as_the_policy(self, name: str) -> None:
        pytest.importorskip("onnx", reason="onnx, of the extra `export`, is missing")
        pytest.importorskip("onnxruntime", reason="onnxruntime, of the extra `export`, is missing")
        source = source_of(name)
        decision = decision_of(source)
        seen = at_random(source, COUNT, seed=1)
        decide = onnx_decisions(model_of(decision, {}))
        agreement = compare("ONNX", decision, source, seen, decide)
        assert agreement.observations == COUNT
        assert agreement.close < 0.01 * COUNT * agreement.parts
        choices, angles = decide(seen)
        assert angles.shape == choices.shape == (COUNT, decision.parts)
        # Lanes do not mix.
        np.testing.assert_array_equal(decide(seen[7:8])[0], choices[7:8])

    def test_a_header_decides_as_the_policy(self, name: str) -> None:
        path = compiler()
        if path is None:
            pytest.skip("there is no C compiler")
        source = source_of(name)
        decision = decision_of(source)
        header = header_of(decision, name, source.settings.control_period, {"of": "a */ test"})
        decide = compiled_decisions(path, header, name, decision.parts)
        seen = at_random(source, COUNT, seed=2)
        assert compare("C", decision, source, seen, decide).observations == COUNT


@pytest.mark.parametrize("name", CARDS)
def test_observations_at_random_ask_for_every_choice(name: str) -> None:
    """Else a comparison would say little."""
    source = made(name)
    seen = at_random(source, COUNT, seed=0)
    assert min(count_of_each(wanted(source, seen))) > 10
    names = [each.name for each in source.settings.features]
    if "side" in names:
        assert {-1.0, 0.0, 1.0} <= set(seen[:, names.index("side")].tolist())


def test_a_header_that_does_not_compile_is_refused() -> None:
    path = compiler()
    if path is None:
        pytest.skip("there is no C compiler")
    source = made("quadrants")
    decision = decision_of(source)
    header = header_of(decision, "quadrants", 0.05, {}).replace("#include <math.h>", "")
    with pytest.raises(ValueError, match="header must compile without a warning"):
        compiled_decisions(path, header, "quadrants", decision.parts)(at_random(source, 4, seed=0))
