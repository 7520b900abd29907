"""`surface-gym export`: write a policy as ONNX and as C, once it is checked."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from surface_gym import checks
from surface_gym.cli import typed
from surface_gym.files import replacing

if TYPE_CHECKING:
    from .check import Agreement
    from .onnx import ModulesDecision
    from .policy import NetworkDecision, Source

Format = Literal["onnx", "c"]
OBSERVATIONS = 10_000


@dataclass(frozen=True)
class ExportConfig:
    """Export an agent for a machine without Python: an ONNX file, a C header, and a page that
    describes the input and the output. Each file decides as the policy does, which is checked.
    """

    name: tyro.conf.Positional[str | None] = None
    """Name of an agent that comes with the package; with --run, the name of the files."""
    seed: int | None = None
    """Seed, if it was trained with several; by default the first."""
    run: Path | None = None
    """Folder of a training run: export its policy instead."""
    task: str | None = None
    """Custom task that the run is of, as path/to/file.py:Class, whose code is run."""
    formats: tuple[Format, ...] = ()
    """Formats to write; by default all that there are for the policy. Modules that share weights
    have no C header."""
    out: Path = Path("exported")
    """Folder for the files."""
    observations: int = OBSERVATIONS
    """Number of observations to compare decisions with the policy's on."""

    def __post_init__(self) -> None:
        if self.run is None:
            from .. import library

            checks.one_of("name", self.name, library.names())
            if self.task is not None:
                raise ValueError(f"task must stand beside --run, got {self.task!r} alone")
        checks.integer("observations", self.observations, least=100)

    def source(self) -> "Source":
        from . import policy

        if self.run is None:
            return policy.shipped(str(self.name), self.seed)
        return policy.of_run(self.run, self.name, self.seed, self.task)


@dataclass(frozen=True)
class Exported:
    """The files of an export."""

    files: tuple[Path, ...]
    # By "ONNX" and "C", as far as they are written; None: there is no compiler.
    checked: "dict[str, Agreement | None]"


def export(
    source: "Source", folder: Path, observations: int = OBSERVATIONS, formats: Sequence[Format] = ()
) -> Exported:
    """Write NAME.onnx, NAME.h and NAME.md, if they decide as the policy does."""
    from . import c_header, check, onnx, page, policy

    checks.integer("observations", observations, least=100)
    is_modules = source.policy.card.algo == "modules"
    if is_modules and "c" in formats:
        raise ValueError(
            f"formats must be onnx for {source.name}, got c: modules that share weights are "
            "exported to ONNX alone"
        )
    metadata, contents = make_metadata(source), {}
    checked: dict[str, Agreement | None] = {}
    make = onnx.modules_decision if is_modules else policy.network_decision
    decision: NetworkDecision | ModulesDecision = make(source)
    examples = check.make_observations(source, observations)
    if not formats or "onnx" in formats:
        contents["onnx"] = make_model(decision, metadata)
        decide = check.run_onnx(contents["onnx"])
        checked["ONNX"] = check.compare("ONNX", decision, source, examples, decide)
    if isinstance(decision, policy.NetworkDecision) and (not formats or "c" in formats):
        period, compiler = source.config.control_period, check.find_compiler()
        header = c_header.make_header(decision, source.name, period, metadata)
        contents["h"], checked["C"] = header.encode(), None
        if compiler is not None:
            decide = check.run_c(compiler, header, source.name, decision.parts)
            checked["C"] = check.compare("C", decision, source, examples, decide)
    contents["md"] = page.make_page(source, metadata, checked).encode()
    files = tuple(folder / f"{source.name}.{ending}" for ending in contents)
    for file, content in zip(files, contents.values(), strict=True):
        with replacing(file) as part:
            part.write_bytes(content)
    return Exported(files, checked)


def make_model(decision: "NetworkDecision | ModulesDecision", metadata: dict[str, str]) -> bytes:
    """Return a decision as an ONNX file's content."""
    from . import onnx

    graph = onnx.Graph()
    if isinstance(decision, onnx.ModulesDecision):
        choices = onnx.add_modules_decision(graph, decision)
    else:
        choices = onnx.add_network_decision(graph, decision)
    return graph.model((decision.features, decision.parts), decision.angles, choices, metadata)


def make_metadata(source: "Source") -> dict[str, str]:
    """Return the metadata of an ONNX file; lists are JSON."""
    import surface_gym

    config, policy = source.config, source.policy
    return {
        "agent": source.name,
        "seed": str(source.seed),
        "task": policy.env_id,
        "algorithm": policy.card.algo,
        "actions": config.actions,
        "control_period": repr(config.control_period),
        "orientations": json.dumps(config.chosen_orientations),
        "observe": json.dumps(config.observe),
        "features": json.dumps([each.name for each in config.features]),
        "preset": source.training.preset,
        "digest": source.digest,
        "surface_gym": surface_gym.__version__,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Export; an error ends it with one line."""
    config = tyro.cli(ExportConfig, prog=typed("export"), args=arguments)
    try:
        exported = export(config.source(), config.out, config.observations, config.formats)
    except ModuleNotFoundError:
        raise  # which `surface_gym.cli` reports
    except (ValueError, ImportError) as error:
        sys.exit(f"error: {error}")
    for what, agreement in exported.checked.items():
        result = "not tried, there is no compiler" if agreement is None else agreement.summary()
        print(f"{what}: {result}")
    for file in exported.files:
        print(file)
