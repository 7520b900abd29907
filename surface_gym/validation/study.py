"""The whole comparison: what runs, and what comes of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rich.console import Console
from rich.progress import track

from surface_gym.sharing import Workers, quiet, share
from surface_gym.validation import convergence, speed, touching, unevenness
from surface_gym.validation.cases import EXPLICIT, IMPLICIT, LONG, PUSHED, Case, Run, run
from surface_gym.validation.comparison import (
    Errors,
    Summary,
    Target,
    errors,
    sorts_from,
    targets,
)

DRAWS = 20  # surfaces for each unevenness
MEETINGS = 30  # of two parcels that push each other


@dataclass(frozen=True, eq=False)
class Study:
    """MuJoCo beside the analytic model, as `python -m surface_gym.validation` reports it."""

    sweep: tuple[Run, ...]  # a run a tilt
    pushed: Run  # v0 = 0.9 m/s on the level
    long: Run  # Figure 12c
    convergence: tuple[convergence.Variant, ...]
    speeds: tuple[speed.Speed, ...]
    spreads: tuple[unevenness.Spread, ...]  # empty if not asked for
    meetings: tuple[touching.MeetingRun, ...] = ()  # empty if not asked for

    @property
    def implicit(self) -> Errors:
        """Of the tilts."""
        return errors(self.sweep, lambda run: run.implicit)

    @property
    def explicit(self) -> Errors:
        """Of the tilts."""
        return errors(self.sweep, lambda run: run.explicit)

    @property
    def summaries(self) -> tuple[Summary, Summary]:
        """Table 7 against `implicit` and against `explicit`."""
        return (
            self.implicit.summary(f"MuJoCo / implicit, {1e3 * IMPLICIT.dt:g} ms"),
            self.explicit.summary(f"MuJoCo / explicit, {1e3 * EXPLICIT.dt:g} ms"),
        )

    @property
    def targets(self) -> tuple[Target, ...]:
        return targets(self.implicit, errors([self.pushed], lambda run: run.implicit))

    @property
    def sorts_from(self) -> dict[str, float | None]:
        """[deg] the least tilt from which on the sort completes, by method."""
        return {
            "MuJoCo": sorts_from(self.sweep, lambda run: run.mujoco),
            "implicit": sorts_from(self.sweep, lambda run: run.implicit),
            "explicit": sorts_from(self.sweep, lambda run: run.explicit),
        }


def carry_out(
    tilts: tuple[float, ...],
    with_unevenness: bool,
    with_touching: bool,
    workers: Workers,
    seed: int,
    console: Console,
) -> Study:
    """Run the comparison in parallel, then the timing alone.

    Args:
        tilts: [deg] of the sweep.
        with_unevenness: whether uneven supports are studied as well.
        with_touching: whether parcels that push each other are.
        workers: processes to share the runs among, or a cluster.
        seed: of the uneven supports and of those parcels.
        console: where the progress is drawn.
    """
    cases = (*(Case(tilt) for tilt in tilts), PUSHED, LONG)
    draws = unevenness.jobs(DRAWS, seed) if with_unevenness else ()
    meetings = [touching.Meeting(seed + k) for k in range(MEETINGS if with_touching else 0)]
    parts: tuple[tuple[Any, Sequence[Any]], ...] = (
        (run, cases),
        (convergence.end, convergence.JOBS),
        (unevenness.ends, draws),
        (touching.run, meetings),
    )
    jobs = [partial(quiet, partial(function, each)) for function, group in parts for each in group]
    done = track(
        share(jobs, workers), "MuJoCo and the analytic model", total=len(jobs), console=console,
        transient=True, disable=not console.is_terminal,
    )  # fmt: skip
    found: dict[int, Any] = dict(done)
    results = iter(found[place] for place in range(len(jobs)))
    runs, variants, ends, meeting_runs = [[next(results) for _ in group] for _, group in parts]
    with console.status("timing, one core"):
        speeds = tuple(speed.measure(method) for method in speed.METHODS)
    return Study(
        sweep=tuple(runs[:-2]),
        pushed=runs[-2],
        long=runs[-1],
        convergence=convergence.variants(variants),
        speeds=speeds,
        spreads=unevenness.spreads(draws, ends) if draws else (),
        meetings=tuple(meeting_runs),
    )
