"""The files of an export, written once they are checked."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import surface_gym
from surface_gym import checks
from surface_gym.whole_files import replacing

from ..modules.policy import ModulesPolicy
from .checking import Agreement, compare, onnx_decisions
from .compiling import compiled_decisions, compiler
from .decision import Decision
from .graph import Graph
from .header import header_of
from .modules import modules_decision
from .observations import observations_for
from .page import page_of
from .source import Source
from .whole import whole_decision

OBSERVATIONS = 10_000


@dataclass(frozen=True)
class Exported:
    """What came of an export."""

    files: tuple[Path, ...]
    checked: dict[str, Agreement | None]  # of "ONNX" and "C"; None: there is no compiler


def export(source: Source, folder: Path, observations: int = OBSERVATIONS) -> Exported:
    """Write NAME.onnx, NAME.h and NAME.md, if they decide as the policy does.

    Args:
        source: of the policy.
        folder: for the files.
        observations: to compare decisions on.

    Raises:
        ValueError: the policy is of a kind that is not exported, or a decision differs.
        ImportError: ONNX or its runtime is missing, which the extra `export` brings.
    """
    checks.integer("observations", observations, least=100)
    decision = decision_of(source)
    told = metadata_of(source)
    model = model_of(decision, told)
    header = header_of(decision, source.name, source.settings.control_period, told)
    seen = observations_for(source, observations)
    path = compiler()
    checked: dict[str, Agreement | None] = {
        "ONNX": compare("ONNX", decision, source, seen, onnx_decisions(model)),
        "C": None,
    }
    if path is not None:
        by_c = compiled_decisions(path, header, source.name, decision.parts)
        checked["C"] = compare("C", decision, source, seen, by_c)
    contents = {
        "onnx": model,
        "h": header.encode(),
        "md": page_of(source, told, checked).encode(),
    }
    files = tuple(folder / f"{source.name}.{ending}" for ending in contents)
    for file, content in zip(files, contents.values(), strict=True):
        with replacing(file) as part:
            part.write_bytes(content)
    return Exported(files, checked)


def decision_of(source: Source) -> Decision:
    """What the policy decides by.

    Raises:
        ValueError: it is of a kind that is not exported.
    """
    if isinstance(source.policy, ModulesPolicy):
        return modules_decision(source)
    return whole_decision(source)


def model_of(decision: Decision, told: dict[str, str]) -> bytes:
    """A decision as an ONNX file's content.

    Raises:
        ImportError: ONNX is missing, which the extra `export` brings.
    """
    graph = Graph()
    choices = decision.add_to(graph)
    angles = graph.add("Gather", graph.array(np.array(decision.angles)), choices)
    return graph.model(decision.features, decision.parts, choices, angles, told)


def metadata_of(source: Source) -> dict[str, str]:
    """What a file says of itself; lists are JSON."""
    settings, policy = source.settings, source.policy
    return {
        "agent": source.name,
        "seed": str(source.seed),
        "task": policy.env_id,
        "algorithm": policy.card.algo,
        "actions": settings.actions,
        "control_period": repr(settings.control_period),
        "orientations": json.dumps(settings.chosen_orientations),
        "observe": json.dumps(settings.observe),
        "features": json.dumps([each.name for each in settings.features]),
        "condition": source.training.condition,
        "digest": source.digest,
        "surface_gym": surface_gym.__version__,
    }
