"""A mutation trial: how many small faults, put into the code one at a time, the tests notice.

`python -m benchmarks.mutation --help`. It works in a copy of the repository, and goes on where it
was broken off: what is killed stays so while its module is the same, and what survived is tried
again once a test has changed.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.mutation_equivalents import EQUIVALENTS
from benchmarks.mutation_sample import Mutant, sample_of
from benchmarks.mutation_targets import TARGETS, Target
from benchmarks.mutation_trial import KILLED, REPOSITORY, SURVIVED, Trial

EQUIVALENT = "equivalent"


@dataclass(frozen=True)
class MutationConfig:
    """Put small faults into the code, one at a time, and count those that the tests notice."""

    modules: tuple[str, ...] = ()
    """Ends of the paths of modules, without .py; none: every one of the table."""
    sample: int = 5
    """Faults in each module."""
    seed: int = 0
    """Of the sample; a larger sample holds a smaller one."""
    folder: Path = Path("mutation")
    """For the copy, its compiled code and results.jsonl."""
    limit: int = 200
    """[s] of the processor for a run of tests; a fault that takes longer is noticed."""


def _is_equivalent(target: Target, mutant: Mutant) -> bool:
    place = (target.module, mutant.function, mutant.was, mutant.becomes)
    return any(place == (e.module, e.function, e.was, e.becomes) for e in EQUIVALENTS)


def _chosen(modules: tuple[str, ...]) -> list[Target]:
    for end in modules:
        if not any(target.module.endswith(f"{end}.py") for target in TARGETS):
            raise ValueError(f"modules must be in benchmarks/mutation_targets.py, got {end!r}")
    ends = tuple(f"{end}.py" for end in modules) or ("",)
    return [target for target in TARGETS if target.module.endswith(ends)]


def _table(results: list[tuple[Target, str, float]]) -> Table:
    """Counts by area."""
    table = Table("area", title="mutants")
    for column in ("tried", KILLED, EQUIVALENT, SURVIVED, "killed of the others", "CPU s each"):
        table.add_column(column, justify="right")
    for area in (*dict.fromkeys(target.area for target, _, _ in results), "all"):
        of_area = [row for row in results if area in (row[0].area, "all")]
        counts = {
            outcome: sum(row[1] == outcome for row in of_area)
            for outcome in (KILLED, EQUIVALENT, SURVIVED)
        }
        run = len(of_area) - counts[EQUIVALENT]
        table.add_row(
            area,
            str(len(of_area)),
            *map(str, counts.values()),
            f"{counts[KILLED] / run:.0%}" if run else "",
            f"{sum(row[2] for row in of_area) / run:.0f}" if run else "",
        )
    return table


def main() -> None:
    """Sample, try, print."""
    config = tyro.cli(MutationConfig)
    console = Console()
    try:
        targets = _chosen(config.modules)
        samples = [
            sample_of(
                (REPOSITORY / target.module).read_text(encoding="utf-8"),
                config.sample,
                f"{config.seed} {target.module}",
            )
            for target in targets
        ]
    except (ImportError, ValueError) as error:
        sys.exit(str(error))
    config.folder.mkdir(parents=True, exist_ok=True)
    trial = Trial(config.folder, config.limit)
    results: list[tuple[Target, str, float]] = []
    # The first of every module, then the second: broken off, it says something of all of them.
    in_turn = [
        (target, mutants[k])
        for k in range(config.sample)
        for target, mutants in zip(targets, samples, strict=True)
        if k < len(mutants)
    ]
    for target, mutant in track(in_turn, "trying", console=console, transient=True):
        if _is_equivalent(target, mutant):
            results.append((target, EQUIVALENT, 0.0))
            continue
        try:
            result = trial.outcome(target, mutant)
        except RuntimeError as error:
            sys.exit(str(error))
        results.append((target, result["outcome"], result["seconds"]))
        if result["outcome"] == SURVIVED:
            where = f"{target.module}:{mutant.line}"
            console.print(
                f"survived: {where}\n  - {mutant.was}\n  + {mutant.becomes}", markup=False
            )
    console.print(_table(results))


if __name__ == "__main__":
    main()
