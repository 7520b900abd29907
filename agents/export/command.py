"""The command line of `python -m agents.export`."""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console

from surface_gym import checks

from .. import library
from .source import Source, of_run, shipped
from .writing import export


@dataclass(frozen=True)
class ExportConfig:
    """Export an agent for a machine without Python: an ONNX file, a C header, and a page that says
    what goes in and out. Each decides as the policy does, which is checked first.
    """

    name: tyro.conf.Positional[str | None] = None
    """Of an agent that comes with the package; with --run, what the files are to be called."""
    seed: int | None = None
    """Of several that it was trained with; by default the first."""
    run: Path | None = None
    """Folder of a training run: export its policy instead."""
    task: str | None = None
    """The task of one's own that the run is of, as path/to/file.py:Class, whose code is run."""
    out: Path = Path("exported")
    """Folder for the files."""
    observations: int = 10_000
    """To compare decisions with the policy's on."""

    def __post_init__(self) -> None:
        if self.run is None:
            checks.one_of("name", self.name, library.names())
            if self.task is not None:
                raise ValueError(f"task must stand beside --run, got {self.task!r} alone")
        checks.integer("observations", self.observations, least=100)

    def source(self) -> Source:
        """What is to be exported.

        Raises:
            ValueError: it does not exist, is damaged, or is not exported.
        """
        if self.run is None:
            return shipped(str(self.name), self.seed)
        return of_run(self.run, self.name, self.seed, self.task)


def main() -> None:
    """Export; an error ends it with one line."""
    config = tyro.cli(ExportConfig, prog=f"python -m {__package__}")
    console = Console()
    try:
        exported = export(config.source(), config.out, config.observations)
    except ModuleNotFoundError:
        raise  # told by the command's start
    except (ValueError, ImportError) as error:
        sys.exit(f"error: {error}")
    for what, agreement in exported.checked.items():
        told = "not tried, there is no compiler" if agreement is None else agreement.told()
        console.print(f"{what}: {told}", highlight=False)
    for file in exported.files:
        console.print(str(file), highlight=False)
