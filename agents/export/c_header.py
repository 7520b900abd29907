"""The decision of a network as a C header that needs nothing but C99's own library."""

import re
import textwrap
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from .policy import Network, NetworkDecision

WIDTH = 100  # of a line
_FUNCTIONS = """\
/* out[outputs] = weights[outputs][inputs] in[inputs] + bias[outputs] */
static inline void {prefix}_layer(const float *weights, const float *bias, const float *in,
                                  int inputs, float *out, int outputs) {{
    for (int k = 0; k < outputs; ++k) {{
        float sum = bias[k];
        for (int i = 0; i < inputs; ++i)
            sum += weights[k * inputs + i] * in[i];
        out[k] = sum;
    }}
}}

/* Index of the greatest score, the first of equal ones. */
static inline int {prefix}_best(const float *scores, int options) {{
    int best = 0;
    for (int k = 1; k < options; ++k)
        if (scores[k] > scores[best])
            best = k;
    return best;
}}
"""
_ACTIVATIONS = {
    "tanh": "{into}[k] = tanhf({into}[k]);",
    "relu": "{into}[k] = {into}[k] > 0.0f ? {into}[k] : 0.0f;",
}


def make_prefix(name: str) -> str:
    """Return what every name in the header of an agent begins with."""
    return f"surface_gym_{re.sub('[^0-9a-z]+', '_', name.lower())}"


def make_header(
    decision: NetworkDecision, name: str, control_period: float, metadata: Mapping[str, str]
) -> str:
    """Return the text of the header."""
    prefix = make_prefix(name)
    capital = prefix.upper()
    tables, statements = _choices(decision, prefix)
    comment = "\n".join(
        textwrap.fill(
            f"{key}: {value}".replace("*/", "* /"),
            WIDTH,
            initial_indent=" * ",
            subsequent_indent=" *     ",
        )
        for key, value in metadata.items()
    )
    return f"""\
/*
 * Made by `surface-gym export`; {name}.md describes the input and the output.
 * C99 and its <math.h> alone; no memory is allocated, nothing is kept between calls.
 *
{comment}
 */
#ifndef {capital}_H
#define {capital}_H

#include <math.h>

#define {capital}_FEATURES {decision.features}
#define {capital}_PARTS {decision.parts}
#define {capital}_CONTROL_PERIOD {_with_point(repr(float(control_period)))} /* [s] */

/* [rad] of the orientations on offer */
{_table(f"{prefix}_orientations", np.array(decision.angles))}
{_weights(decision.network, prefix)}
{tables}
{_FUNCTIONS.format(prefix=prefix)}
{_scores(decision.network, prefix)}
/* The orientation that each part is to take. */
static inline void {prefix}_choose(const float observation[{decision.features}],
                                   int choices[{decision.parts}]) {{
{textwrap.indent(statements, "    ")}
}}

/* The axis angle [rad] that each part is to take. */
static inline void {prefix}_decide(const float observation[{decision.features}],
                                   double angles[{decision.parts}]) {{
    int choices[{decision.parts}];
    {prefix}_choose(observation, choices);
    for (int part = 0; part < {decision.parts}; ++part)
        angles[part] = {prefix}_orientations[choices[part]];
}}

#endif
"""


def _choices(decision: NetworkDecision, prefix: str) -> tuple[str, str]:
    """Tables, and statements that fill `choices` from `observation`."""
    options, width = decision.options.shape
    tables = _table(f"{prefix}_options", decision.options)
    symmetry = decision.symmetry
    to = "choices" if symmetry is None else "seen"
    lines = [
        f"float scores[{decision.network.outputs}];",
        f"{prefix}_scores(observation, scores);",
        f"for (int group = 0; group < {decision.groups}; ++group) {{",
        f"    const int option = {prefix}_best(scores + {options} * group, {options});",
        f"    for (int k = 0; k < {width}; ++k)",
        f"        {to}[{width} * group + k] = {prefix}_options[{width} * option + k];",
        "}",
    ]
    if symmetry is not None:
        tables += _table(f"{prefix}_images", symmetry.images)
        tables += _table(f"{prefix}_parts", symmetry.parts)
        lines = [
            f"int seen[{decision.parts}];",
            *lines,
            f"const int mirrored = observation[{symmetry.side}] < 0.0f;",
            f"for (int part = 0; part < {decision.parts}; ++part)",
            f"    choices[part] = mirrored ? {prefix}_images[seen[{prefix}_parts[part]]] "
            ": seen[part];",
        ]
    return tables, "\n".join(lines)


def _weights(network: Network, prefix: str) -> str:
    return "\n".join(
        _table(f"{prefix}_weights_{k}", layer.weights) + _table(f"{prefix}_bias_{k}", layer.bias)
        for k, layer in enumerate(network.layers)
    )


def _scores(network: Network, prefix: str) -> str:
    lines, source = [], "inputs"
    last = len(network.layers) - 1
    for k, layer in enumerate(network.layers):
        outputs, inputs = layer.weights.shape
        into = "scores" if k == last else f"hidden_{k}"
        if k < last:
            lines.append(f"float {into}[{outputs}];")
        lines.append(
            f"{prefix}_layer({prefix}_weights_{k}, {prefix}_bias_{k}, {source}, {inputs}, "
            f"{into}, {outputs});"
        )
        if k < last:
            lines.append(f"for (int k = 0; k < {outputs}; ++k)")
            lines.append("    " + _ACTIVATIONS[network.activation].format(into=into))
        source = into
    body = textwrap.indent("\n".join(lines), "    ")
    return f"""\
/* The network. */
static inline void {prefix}_scores(const float inputs[{network.inputs}],
                                   float scores[{network.outputs}]) {{
{body}
}}
"""


def _table(name: str, values: NDArray[np.float32 | np.float64 | np.int64]) -> str:
    """A C array of numbers that read back as the same, row by row."""
    numbers = values.ravel().tolist()
    if values.dtype == np.float32:
        kind, texts = "float", (f"{_with_point(f'{value:.9g}')}f" for value in numbers)
    elif values.dtype == np.float64:
        kind, texts = "double", (_with_point(repr(value)) for value in numbers)
    else:
        kind, texts = "int", (str(value) for value in numbers)
    rows = _fill(texts)
    return f"static const {kind} {name}[{values.size}] = {{\n{rows}\n}};\n"


def _fill(texts: Iterable[str]) -> str:
    return textwrap.fill(", ".join(texts), WIDTH, initial_indent="    ", subsequent_indent="    ")


def _with_point(digits: str) -> str:
    """A number that C does not take for an integer."""
    return digits if set(digits) & set(".e") else f"{digits}.0"
