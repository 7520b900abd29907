"""Decisions of modules that share weights: each that bears the parcel chooses for itself."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..mirror import mirrored_orientations
from .arrays_in_c import table_of_integers
from .decision import Integers, Singles, close_scores
from .formula import Formula, reckon
from .formulas_in_c import formulas_in_c
from .graph import OBSERVATION, Graph
from .module_view import SeenByModule, seen_by_module
from .network import Layer, Network, array_of
from .source import Source

_APART = ("side", "time")  # features that modules do not see
_FIRST, _PLACE, _BETWEEN, _LAST = "_alike", "_apart", "_between", "_logits"  # names of the weights


@dataclass(frozen=True, eq=False)
class ModulesDecision:
    """What all modules see and what each sees of itself goes through one network."""

    network: Network
    features: int
    shared: Integers  # (shared,) places of the features that all see
    seen: SeenByModule
    images: Integers  # (choices,) each orientation's in the mirror
    rest: int  # choice of the others
    parts: int
    angles: tuple[float, ...]  # [rad] of the orientations on offer

    @property
    def _formulas(self) -> tuple[Formula, ...]:
        return (*self.seen.place, self.seen.bears, self.seen.mirrored)

    def in_doubt(self, observations: Singles, tie: float) -> NDArray[np.bool_]:
        (*place, bears, _), doubt = reckon(self._formulas, observations)
        shape = (len(observations), self.parts)
        own = np.stack([np.broadcast_to(each, shape) for each in place], axis=2)
        alike = np.repeat(observations[:, np.newaxis, self.shared], self.parts, axis=1)
        inputs = np.concatenate([alike, own.astype(np.float32)], axis=2)
        close = np.zeros(shape, dtype=np.bool_)
        bearing = np.broadcast_to(bears, shape)
        scores = self.network.scores(inputs[bearing].astype(np.float64))
        close[bearing] = close_scores(scores, tie)
        return close | doubt

    def add_to(self, graph: Graph) -> str:
        *place, bears, mirrored = graph.formulas(self._formulas)
        last = graph.whole(2)
        own = graph.add("Concat", *(graph.add("Unsqueeze", each, last) for each in place), axis=2)
        alike = graph.add("Gather", OBSERVATION, graph.array(self.shared), axis=1)
        one = graph.add("Unsqueeze", alike, graph.whole(1))
        each = graph.add("Expand", one, graph.whole(1, self.parts, 1))
        inputs = graph.add("Concat", each, graph.cast(own, "FLOAT"), axis=2)
        best = graph.add("ArgMax", graph.network(self.network, inputs), axis=2, keepdims=0)
        image = graph.add("Gather", graph.array(self.images), best)
        turned = graph.add("Where", mirrored, image, best)
        return graph.add("Where", bears, turned, graph.array(np.array(self.rest)))

    def in_c(self, prefix: str) -> tuple[str, str]:
        told = formulas_in_c(self._formulas, prefix)
        *place, bears, mirrored = told.results
        alike = len(self.shared)
        tables = (
            told.tables
            + table_of_integers(f"{prefix}_shared", self.shared)
            + table_of_integers(f"{prefix}_images", self.images)
        )
        own = [f"inputs[{alike + k}] = (float){number};" for k, number in enumerate(place)]
        lines = [
            f"float inputs[{self.network.inputs}], scores[{self.network.outputs}];",
            f"for (int k = 0; k < {alike}; ++k)",
            f"    inputs[k] = observation[{prefix}_shared[k]];",
            *told.once,
            f"for (int module = 0; module < {self.parts}; ++module) {{",
            *(f"    {line}" for line in told.of_module),
            f"    choices[module] = {self.rest};",
            f"    if (!({bears}))",
            "        continue;",
            *(f"    {line}" for line in own),
            f"    {prefix}_scores(inputs, scores);",
            f"    const int best = {prefix}_best(scores, {self.network.outputs});",
            f"    choices[module] = {mirrored} ? {prefix}_images[best] : best;",
            "}",
        ]
        return tables, "\n".join(lines)


def modules_decision(source: Source) -> ModulesDecision:
    """That of modules that share weights, for the zone they were trained on."""
    settings = source.settings
    angles = settings.chosen_orientations
    kind = settings.action_kind
    names = [each.name for each in settings.features]
    return ModulesDecision(
        _network(source),
        len(names),
        np.array([k for k, name in enumerate(names) if name not in _APART], dtype=np.int64),
        seen_by_module(settings),
        mirrored_orientations(angles),
        int(np.abs(np.sin(angles)).argmax()),
        kind.size,
        angles,
    )


def _network(source: Source) -> Network:
    """The weights for what all see, and for what each sees, side by side."""
    arrays = {name: array_of(values) for name, values in source.weights.items()}
    first = np.concatenate([arrays[f"{_FIRST}.weight"], arrays[f"{_PLACE}.weight"]], axis=1)
    between = sorted(
        {int(name.split(".")[1]) for name in arrays if name.startswith(f"{_BETWEEN}.")}
    )
    names = [*(f"{_BETWEEN}.{k}" for k in between), _LAST]
    later = (Layer(arrays[f"{name}.weight"], arrays[f"{name}.bias"]) for name in names)
    return Network((Layer(first, arrays[f"{_FIRST}.bias"]), *later), "tanh")
