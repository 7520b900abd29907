"""A decision as a C header that needs nothing but C99's own library."""

import re
import textwrap
from collections.abc import Mapping

from .arrays_in_c import double, table_of_doubles, table_of_singles
from .decision import Decision
from .network import Network

_LAYER = """\
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

/* Place of the greatest score, the first of equal ones. */
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


def prefix_of(name: str) -> str:
    """What every name in the header of an agent begins with."""
    return f"surface_gym_{re.sub('[^0-9a-z]+', '_', name.lower())}"


def header_of(decision: Decision, name: str, control_period: float, told: Mapping[str, str]) -> str:
    """The text of the header.

    Args:
        decision: that it makes.
        name: of the agent.
        control_period: [s] between decisions.
        told: what stands above it all.
    """
    prefix, network = prefix_of(name), decision.network
    capital = prefix.upper()
    tables, statements = decision.in_c(prefix)
    above = "\n".join(_comment(f"{key}: {value}") for key, value in told.items())
    return f"""\
/*
 * Made by surface_gym's `python -m agents.export`; {name}.md says what goes in and out.
 * C99 and its <math.h> alone; no memory is allocated, nothing is kept between calls.
 *
{above}
 */
#ifndef {capital}_H
#define {capital}_H

#include <math.h>

#define {capital}_FEATURES {decision.features}
#define {capital}_PARTS {decision.parts}
#define {capital}_CONTROL_PERIOD {double(control_period)} /* [s] */

/* [rad] of the orientations on offer */
{table_of_doubles(f"{prefix}_orientations", decision.angles)}
{_weights(network, prefix)}
{tables}
{_LAYER.format(prefix=prefix)}
{_scores(network, prefix)}
/* Which orientation each part is to take. */
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


def _comment(text: str) -> str:
    return textwrap.fill(
        text.replace("*/", "* /"), 100, initial_indent=" * ", subsequent_indent=" *     "
    )


def _weights(network: Network, prefix: str) -> str:
    """Weights and bias of each layer, a row an output."""
    return "\n".join(
        table_of_singles(f"{prefix}_weights_{k}", layer.weights)
        + table_of_singles(f"{prefix}_bias_{k}", layer.bias)
        for k, layer in enumerate(network.layers)
    )


def _scores(network: Network, prefix: str) -> str:
    """A function from inputs to scores."""
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
