"""How far the implicit step is from the paper's explicit one at 10 microseconds."""

from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import surface_gym as sg

STEPS = (0.010, 0.005, 0.002, 0.001)  # [s]
FINE = 1e-5  # [s]
AXES = np.radians([0.0, 45.0, -45.0, 90.0])


@dataclass(frozen=True)
class Scene:
    """A random surface, parcel and start."""

    surface: sg.Surface
    parcel: sg.Parcel
    pose: tuple[float, float, float]
    velocity: tuple[float, float, float]
    duration: float  # [s]


def draw_scene(rng: np.random.Generator) -> Scene:
    """Every module's axis on its own, both boxes, tilts of 0-15 deg, sliding and spinning."""
    surface = sg.Surface(
        axis=rng.choice(AXES, size=(30, 60)),
        rotor=rng.random((30, 60)) < 0.8,
        tilt=rng.choice([0.0, rng.uniform(0.0, np.radians(15.0))]),
    )
    return Scene(
        surface=surface,
        parcel=sg.layouts.box(str(rng.choice(["S", "B"]))),
        pose=(1.0, 1.5 + rng.uniform(-0.1, 0.1), rng.uniform(-np.pi, np.pi)),
        velocity=(rng.uniform(0.5, 2.7), rng.uniform(-0.5, 0.5), rng.uniform(-3.0, 3.0)),
        duration=rng.uniform(0.4, 1.0),
    )


def reference(scene: Scene) -> np.ndarray | None:
    """End pose of the explicit method at its finest; None where the scene leaves its domain.

    The paper's rules assume motion towards +x, so a scene in which vx does not stay positive, or
    in which the parcel leaves the surface, is drawn again.
    """
    run = sg.simulate(
        scene.surface,
        scene.parcel,
        scene.pose,
        scene.velocity,
        scene.duration,
        FINE,
        method="explicit",
    )
    return run.pose[-1] if run.end == "duration" and run.velocity[:, 0].min() > 0.0 else None


def measure(scenes: int, seed: int, console: Console) -> dict[float, np.ndarray]:
    """Errors (scenes, 2) of position [mm] and angle [deg] by step [s]."""
    rng = np.random.default_rng(seed)
    errors: dict[float, list[tuple[float, float]]] = {dt: [] for dt in STEPS}
    for _ in track(range(scenes), "scenes at 10 microseconds", console=console, transient=True):
        fine = None
        while fine is None:
            scene = draw_scene(rng)
            fine = reference(scene)
        for dt in STEPS:
            end = sg.simulate(
                scene.surface, scene.parcel, scene.pose, scene.velocity, scene.duration, dt
            ).pose[-1]
            position = 1000.0 * np.hypot(*(end - fine)[:2])
            errors[dt].append((position, np.degrees(abs(end[2] - fine[2]))))
    return {dt: np.array(rows) for dt, rows in errors.items()}


def table(errors: dict[float, np.ndarray]) -> Table:
    """Median, 90th percentile and largest error by step."""
    count = len(next(iter(errors.values())))
    result = Table("step [ms]", title=f"implicit against explicit at 10 us, {count} random scenes")
    for what in ("position [mm]", "angle [deg]"):
        for figure in ("median", "p90", "max"):
            result.add_column(f"{what}\n{figure}", justify="right")
    for dt, rows in errors.items():
        figures = [
            f"{value:.2f}"
            for column in rows.T
            for value in (np.median(column), np.percentile(column, 90), column.max())
        ]
        result.add_row(f"{1000 * dt:g}", *figures)
    return result
