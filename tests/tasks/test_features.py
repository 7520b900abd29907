"""Features and their scales, which stand once."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surface_gym.agents.planning.layouts import ShownPath
from surface_gym.compiler.jit import compiled, compute_digest as digest_of_code
from surface_gym.config import EnvConfig
from surface_gym.feature_groups import GROUPS
from surface_gym.registration import TASKS as REGISTRY
from surface_gym.tasks import features as module
from surface_gym.tasks.features import (
    Feature,
    columns,
    compute_digest,
    decode,
    encode,
    read,
    show,
    show_bent,
    show_within,
)

ROOT = Path(__file__).parents[2]
GAP, SIZE = (
    Feature("gap", -2.0, 3.0, "", "m", 0.5),
    Feature("size", -1.0, 9.0, "", "m", 0.05, 0.175),
)
FINE = Feature("to go, fine", -1.0, 1.0, "", "m", 0.01, bent=True)
SHOWN = columns((GAP, SIZE, FINE))
TASKS = {name: kind.features for name, kind in REGISTRY.items()} | {
    "shown path": ShownPath.features,
    **{name: group.features for name, group in GROUPS.items()},
}
# A scale beside a value, as it stood in kernels and decoders.
SCALES = (
    r"\b0\.175\b",
    r"[*/] 0\.05\b",
    r"\b0\.05 \*",
    r"/ 0\.3\b(?! m)",
    r"\b0\.3 \* (see|row|shown)",
)
# Numbers there are scales of what networks see of a schedule.
OTHER = {"agents/scheduling/decisions.py"}


@compiled
def show_all(see, value):
    show(see, SHOWN.gap, value)
    show(see, SHOWN.size, value)
    show_bent(see, SHOWN.to_go_fine, value)
    see[3] = read(see, SHOWN.size)
    show_within(see, SHOWN.gap, 10.0 * value)


def test_a_compiled_function_shows_values_as_python_does() -> None:
    for see, function in ((np.zeros(4), show_all), (np.zeros(4), show_all.py_func)):
        function(see, 0.21)
        assert see.tolist() == [
            3.0,
            (0.21 - 0.175) / 0.05,
            math.tanh(0.21 / 0.01),
            0.175 + 0.05 * see[1],
        ]


def test_of_a_table_of_any_shape_and_precision() -> None:
    table = np.zeros((2, 5, 3), dtype=np.float32)
    table[..., 1] = 1.0
    assert SHOWN.size.of(table).dtype == np.float32
    np.testing.assert_array_equal(SHOWN.size.of(table), np.full((2, 5), 0.225, dtype=np.float32))
    np.testing.assert_array_equal(SHOWN.gap.of(table.astype(np.float64)), np.zeros((2, 5)))


@pytest.mark.parametrize("name", TASKS)
def test_what_is_shown_decodes_to_what_it_was(name: str) -> None:
    values = np.random.default_rng(0).uniform(-2.0, 2.0, 100)
    for place, (feature, column) in enumerate(zip(TASKS[name], columns(TASKS[name]), strict=True)):
        assert column.place == place
        assert feature.low < feature.high
        assert feature.scale > 0.0
        assert not feature.bent or (feature.low, feature.high) == (-1.0, 1.0)
        shown = encode(column, values)
        np.testing.assert_allclose(decode(column, shown), values, rtol=1e-15, atol=1e-15)
        np.testing.assert_allclose(
            encode(column, decode(column, shown)), shown, rtol=1e-12, atol=1e-13
        )


def test_a_name_that_is_gone_is_named() -> None:
    with pytest.raises(AttributeError, match="length"):
        _ = SHOWN.length
    config = EnvConfig("sort", actions="halves")
    seen = np.zeros(len(config.features))
    with pytest.raises(
        ValueError, match="features must contain 'asked angle', got lateral offset,"
    ):
        _ = config.observed(seen)["asked angle"]
    np.testing.assert_array_equal(config.observed(seen).get("asked angle", 2.0), [2.0])
    with pytest.raises(ValueError, match="names that differ, got 'gap' twice"):
        columns((GAP, replace(SIZE, name="gap")))


def test_how_it_is_shown_is_described() -> None:
    described = [each.formula for each in (GAP, SIZE, FINE, Feature("side", -1.0, 1.0))]
    assert described == [
        "value / 0.5 m", "(value - 0.175 m) / 0.05 m", "tanh(value / 0.01 m)", "value",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"scale": 0.0}, "scale of feature 'gap' must be greater than 0, got 0.0"),
        ({"offset": math.nan}, "offset of feature 'gap' must be a finite number, got nan"),
        ({"low": 3.0}, "low of feature 'gap' must be below high, got 3.0 and 3.0"),
    ],
)
def test_what_no_observation_can_show_is_refused(given: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(GAP, **given)


def test_digests_see_a_changed_scale_and_a_changed_order() -> None:
    shown = (GAP, SIZE)
    others = [
        (SIZE, GAP),
        (GAP,),
        (GAP, replace(SIZE, scale=0.06)),
        (GAP, replace(SIZE, offset=0.2)),
    ]
    assert len({compute_digest(each) for each in (shown, *others)}) == 5
    assert compute_digest(shown) == compute_digest((replace(GAP, meaning="clear", high=9.0), SIZE))
    # That of compiled code, by which its cache is found: names count, too.
    codes = {digest_of_code(show_all.py_func, columns(each)) for each in (shown, *others)}
    assert len(codes) == 5
    swapped = columns((replace(GAP, name="size"), replace(SIZE, name="gap")))
    assert digest_of_code(show_all.py_func, swapped) not in codes


def test_no_scale_stands_a_second_time() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for folder in ("surface_gym", "agents")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if str(path.relative_to(ROOT)) not in OTHER
        for line in path.read_text().splitlines()
        if any(re.search(scale, line) for scale in SCALES) and "Feature(" not in line
    ]
    assert not found
    assert re.search(SCALES[0], Path(module.__file__).with_name("base.py").read_text())
