"""`python -m benchmarks.swivelling`: axes that turn under load, compared with MuJoCo's rotors.

In MuJoCo a rotor is a sphere on a hinge. A vertical joint through the contact turns the hinge.
Point contacts, as in the package, do not resist this turn. Contact patches resist it by friction
(scrubbing).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import surface_gym as sg
from surface_gym import checks, parallel
from surface_gym.actions import angle_after
from surface_gym.physics.references import step_implicit
from surface_gym.physics.types import GRAVITY, SPANS, Array, make_scratch
from surface_gym.simulation import base_motion, start_state
from surface_gym.surface import Surface
from surface_gym.validation import simulation
from surface_gym.validation.simulation import Recipe, Swivel

SHAPE = (12, 20)  # rows and columns, all of them rotors
AXES = np.radians([0.0, 45.0, -45.0, 90.0])
BEGIN, QUARTER_TURN, DURATION = 0.1, 0.05, 0.4  # [s]
SPEED = 0.5 * math.pi / QUARTER_TURN  # [rad/s] of the axes
PATCHES = (0.0, 0.001, 0.002, 0.005)  # [m]
# Our model has rotors without inertia.
RECIPE = Recipe().lighter_rotors(1000.0)


@dataclass(frozen=True)
class SwivelCase:
    """A random parcel that slides over rotors while all axes turn, each row to a random angle."""

    seed: int
    alike: bool = False  # whether all axes turn anti-clockwise by 45 deg, so that scrubbing adds up

    @cached_property
    def drawn(self) -> tuple[Surface, sg.Parcel, Array, Array, Array]:
        """Surface, parcel, pose, velocity, and the axes (rows, columns) [rad] to turn to."""
        rng = np.random.default_rng(self.seed)
        rows = AXES[rng.integers(0, 4, (2, SHAPE[0], 1))]
        axis, target = np.broadcast_to(rows, (2, *SHAPE))
        if self.alike:
            axis, target = np.zeros(SHAPE), np.full(SHAPE, math.pi / 4)
        parcel = sg.layouts.box("SB"[self.seed % 2])
        pose = np.array([0.5, 0.6 + rng.uniform(-0.05, 0.05), rng.uniform(-0.3, 0.3)])
        velocity = np.array([rng.uniform(1.2, 2.2), rng.uniform(-0.2, 0.2), rng.uniform(-1.0, 1.0)])
        return Surface(axis, np.ones(SHAPE, dtype=bool)), parcel, pose, velocity, target

    def analytic(self, dt: float, begin: float = BEGIN) -> Array:
        """Return the end pose (3,) by the package in steps `dt`; axes turn from `begin` [s] on."""
        surface, parcel, pose, velocity, target = self.drawn
        state, scratch = start_state(parcel, pose, velocity), make_scratch()
        axis = surface.axis.copy()
        for k in range(round(DURATION / dt)):
            turned = SPEED * dt if k * dt >= begin - 1e-9 else 0.0
            for place in np.ndindex(*SHAPE):
                axis[place] = angle_after(axis[place], target[place], turned)
            here = Surface(axis, surface.rotor)
            scratch.marks[SPANS] = -1
            step_implicit(here.grid, parcel.body, state, scratch, dt)
        end: Array = base_motion(parcel, state[np.newaxis])[0][0]
        return end

    def mujoco(self, patch: float, begin: float = BEGIN) -> Array:
        """Return the end pose (3,) by MuJoCo with contact patches of a radius [m], 0 for points."""
        surface, parcel, pose, velocity, target = self.drawn
        within = simulation.reachable(surface, parcel, pose, velocity, DURATION)
        (run,) = simulation.simulate_together(
            surface, [parcel], pose[np.newaxis], velocity[np.newaxis], DURATION, within, RECIPE,
            swivel=Swivel(target, begin, SPEED, patch),
        )  # fmt: skip
        end: Array = run.pose[-1]
        return end

    def bound(self, patch: float) -> float:
        """Return an upper bound of the angle [rad] by which scrubbing turns the parcel.

        All contacts turn the parcel the same way at their limit of friction, 2/3 mu N patch, as
        long as axes turn. Nothing slows the parcel's rotation afterwards.
        """
        surface, parcel, *_, target = self.drawn
        apart = np.abs(target - surface.axis)
        turning = float(np.minimum(apart, math.pi - apart).max()) / SPEED
        gyration = parcel.moment_of_inertia / parcel.mass
        rate = 2.0 / 3.0 * float(surface.mu_max) * GRAVITY * patch * turning / gyration
        return rate * (DURATION - BEGIN - 0.5 * turning)


def describe_scrubbing(patch: float) -> str:
    """Return as text an axis' torque and work for a patch's radius [m], 20 kg and friction 0.5."""
    torque = 2.0 / 3.0 * 0.5 * 20.0 * GRAVITY * patch
    return f"{torque:.3f} N m and {0.5 * math.pi * torque:.3f} J a quarter turn under 20 kg"


def run_case(case: SwivelCase) -> Array:
    """Return the end poses (4 + patches, 3) of a case.

    Rows: the package and MuJoCo with axes that never turn; the package at 5 ms and at 1 ms; MuJoCo
    with each radius in `PATCHES`.
    """
    fixed = case.analytic(0.001, math.inf), case.mujoco(0.0, math.inf)
    ours = [case.analytic(dt) for dt in (0.005, 0.001)]
    return np.array([*fixed, *ours, *(case.mujoco(patch) for patch in PATCHES)])


@dataclass(frozen=True)
class SwivelOptions:
    """Compare axes that turn under load with MuJoCo's swivelling rotors."""

    cases: int = 12
    """Number of runs with random axes in each row, and of runs in which all axes turn alike."""
    workers: int = parallel.usable_cores()
    """Number of parallel processes."""

    def __post_init__(self) -> None:
        checks.integer("cases", self.cases, least=1)


def describe(apart: Array) -> str:
    """Return as text the median and the largest of differences (cases, 3) [m, m, rad]."""
    distance = 1e3 * np.hypot(apart[:, 0], apart[:, 1])
    angle = np.degrees(np.abs(apart[:, 2]))
    return (
        f"{np.median(distance):.2f} mm, {np.median(angle):.2f} deg; "
        f"{distance.max():.2f} mm, {angle.max():.2f} deg"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the comparison."""
    options = tyro.cli(SwivelOptions, args=arguments, prog="python -m benchmarks.swivelling")
    kinds = {"random axes of each row": False, "all axes turn alike": True}
    cases = [SwivelCase(seed, alike) for alike in kinds.values() for seed in range(options.cases)]
    jobs = [partial(parallel.without_report, partial(run_case, each)) for each in cases]
    found = dict(
        track(
            parallel.map_jobs(jobs, options.workers), total=len(jobs),
            console=Console(stderr=True), transient=True,
        )
    )  # fmt: skip
    ends = np.array([found[k] for k in range(len(jobs))]).reshape(2, options.cases, -1, 3)
    table = Table("end pose, median; worst", *kinds, title="Axes that turn under load")
    fine, point = 3, 4
    rows = {
        "axes never turn: ours, 1 ms, from MuJoCo": (0, 1),
        "ours, 1 ms, from MuJoCo with point contacts": (fine, point),
        "ours, 5 ms, from ours, 1 ms": (fine - 1, fine),
        **{
            f"MuJoCo: patches of {1e3 * patch:g} mm from point contacts": (point + k, point)
            for k, patch in enumerate(PATCHES)
            if k > 0
        },
    }
    for name, (one, other) in rows.items():
        table.add_row(name, *(describe(each[:, one] - each[:, other]) for each in ends))
    console = Console()
    console.print(table)
    for k, patch in enumerate(PATCHES[1:], 1):
        bound = np.array([each.bound(patch) for each in cases]).reshape(2, -1)
        turned = np.abs(ends[:, :, point + k, 2] - ends[:, :, point, 2])
        console.print(
            f"patches of {1e3 * patch:g} mm: at most {np.degrees(bound.max()):.2f} deg by the "
            f"bound, turned by up to {(turned / bound).max():.0%} of it; an axis needs "
            f"{describe_scrubbing(patch)}"
        )


if __name__ == "__main__":
    main()
