"""What a batch is made with: rules that all lanes have in common, and the memory of each."""

import math
from typing import Any

import numpy as np

from surface_gym.actions.commands import CONVEYOR, Acting
from surface_gym.batch.kernels import Rules
from surface_gym.dynamics.axes import directions_of
from surface_gym.lanes.memory import (
    COMMON_OUTCOMES,
    Lanes,
    Sizes,
    Surfaces,
    make_lanes,
    make_surfaces,
)
from surface_gym.settings import Settings


def rules_of(settings: Settings) -> Rules:
    """The rules of an environment."""
    task, kind = settings.chosen_task, settings.action_kind
    features = len(task.features)
    outcomes = len(COMMON_OUTCOMES) + len(task.outcomes)
    return surface_rules_of(settings, features, features + kind.window_size, outcomes)


def surface_rules_of(settings: Any, features: int, axes_from: int, outcomes: int) -> Rules:
    """The rules of surfaces, by an environment's settings.

    Args:
        settings: of whatever runs on them.
        features: that are observed of it.
        axes_from: place in the observation from which axes are shown.
        outcomes: that there are.
    """
    plant, timing, kind = settings.chosen_plant, settings.timing, settings.action_kind
    return Rules(
        elements=plant.geometry,
        timing=timing,
        acting=Acting(
            kind.rows,
            np.array(settings.chosen_orientations),
            settings.actuators.axis_speed * timing.dt,
        ),
        friction=plant.friction.copy(),
        assumed=settings.sensors.friction(plant).copy(),
        stiffness=np.ones((plant.rows, plant.columns)),
        sensor=np.array(settings.sensors.numbers(timing.dt), dtype=np.float64),
        features=features,
        axes_from=axes_from,
        outcomes=outcomes,
    )


def memory_of(settings: Settings, lanes: int) -> tuple[Surfaces, Lanes]:
    """Memory for lanes of an environment, every axis the conveyor's."""
    task, plant, kind = settings.chosen_task, settings.chosen_plant, settings.action_kind
    sizes = Sizes(
        lanes=lanes,
        rows=plant.rows,
        columns=plant.columns,
        command=kind.size,
        choices=kind.choices,
        observation=len(settings.features),
        terms=len(task.terms),
        goals=task.goals,
        memories=task.memories,
        figures=len(task.figures),
        kept=settings.sensors.kept,
        path=task.has_path,
        noise=settings.draws > 0,
        turning=settings.actuators.axis_speed != math.inf,
        stiffness=settings.randomisation.stiffness > 0.0,
    )
    return surfaces_of(settings, sizes), make_lanes(sizes)


def surfaces_of(settings: Any, sizes: Sizes) -> Surfaces:
    """Memory for surfaces whose axes are all the conveyor's, by an environment's settings."""
    surfaces = make_surfaces(sizes)
    surfaces.direction[:] = CONVEYOR
    if sizes.choices and not sizes.turning:  # axes count the orientations on offer
        angles = np.array(settings.chosen_orientations)
        surfaces.direction[0, :-1] = directions_of(angles)
        surfaces.axis[:] = len(angles)
    return surfaces
