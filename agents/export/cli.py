"""`surface-gym export`: check a policy's ONNX graph, and write it to a file."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from surface_gym import checks
from surface_gym.cli import parse_options
from surface_gym.files import replacing

if TYPE_CHECKING:
    from .check import Agreement
    from .policy import Source

OBSERVATIONS = 10_000


@dataclass(frozen=True)
class ExportConfig:
    """Export an agent to an ONNX file, with a page that describes the file's input and output.

    The file's decisions are compared with the decisions of the agent's policy.
    """

    name: tyro.conf.Positional[str | None] = None
    """Name of a shipped agent; with --run, name of the written files."""
    seed: int | None = None
    """Seed of an agent that was trained with several; the default is the first."""
    run: Path | None = None
    """Folder of a training run, to export its policy instead."""
    task: str | None = None
    """Custom task of the run, as path/to/file.py:Class; its code is executed."""
    out: Path = Path("exported")
    """Folder for the files."""
    observations: int = OBSERVATIONS
    """Number of observations for the comparison with the policy."""

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


def export(
    source: "Source", folder: Path, observations: int = OBSERVATIONS
) -> "tuple[tuple[Path, Path], Agreement]":
    """Write NAME.onnx and NAME.md; return the files, and the result of the comparison.

    Args:
        observations: number of observations for which decisions of file and policy are compared.

    Raises:
        ValueError: the policy is not of PPO or DQN, or decisions differ. Then no file is written.
    """
    from ..policy import Policy
    from . import check, onnx, policy

    checks.integer("observations", observations, least=100)
    if not isinstance(source.policy, Policy):
        raise ValueError(
            f"name must be an agent of PPO or DQN, got {source.name!r}: a policy of "
            "modules selects modules by the observation"
        )
    decision = policy.network_decision(source)
    metadata = make_metadata(source)
    model = onnx.make_model(decision, metadata)
    examples = check.make_observations(source, observations)
    agreement = check.compare(decision, source, examples, check.run_onnx(model))
    text = check.make_page(source, metadata, agreement)
    files = folder / f"{source.name}.onnx", folder / f"{source.name}.md"
    for file, content in zip(files, (model, text.encode()), strict=True):
        with replacing(file) as part:
            part.write_bytes(content)
    return files, agreement


def make_metadata(source: "Source") -> dict[str, str]:
    """Return the metadata of an ONNX file, as texts by key. Lists are JSON."""
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
        "observe": json.dumps(config.observed_groups),
        "features": json.dumps([each.name for each in config.features]),
        "preset": source.training.preset,
        "digest": source.digest,
        "surface_gym": surface_gym.__version__,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. If there is an error, print it on one line and exit with status 1."""
    config = parse_options(ExportConfig, "export", arguments)
    try:
        files, agreement = export(config.source(), config.out, config.observations)
    except ModuleNotFoundError:
        raise  # which `surface_gym.cli` reports
    except (ValueError, ImportError) as error:
        sys.exit(f"error: {error}")
    print(f"ONNX: {agreement.summary()}")
    for file in files:
        print(file)
