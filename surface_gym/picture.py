"""From a batch's lane to the scene that is drawn; imports drawing, so import it to draw."""

import numpy as np
from numpy.typing import NDArray

from surface_gym.core.batch import Batch
from surface_gym.physics.types import RADIUS
from surface_gym.rendering import Scene
from surface_gym.state import GRAVITY_ALONG, RUNNING, EnvState

_DISC = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)


def scene_of(
    batch: Batch, state: int, trail: NDArray[np.float64], title: str | None = None
) -> Scene:
    """The scene of a lane.

    Args:
        batch: the lanes.
        lane: which.
        trail: (points, 2) [m] where the centre has been.
        title: of the picture; the task's name by default.
    """
    lanes = batch.parcels
    truth, sensed = lanes.truth[state], lanes.sensed[state]
    apart = np.abs(truth[:3] - sensed[:3]).max() > 1e-9
    outcome = int(lanes.outcome[state])
    plant = batch.settings.chosen_plant
    view = batch.view(state)
    readings: list[tuple[str, str]] = [
        ("time", f"{lanes.clock[state]:.2f} s"),
        ("speed", f"{np.hypot(truth[3], truth[4]):.2f} m/s"),
        ("heading", f"{np.degrees(truth[2]):+.1f}\N{DEGREE SIGN}"),
        *batch.task.readings(view),
    ]
    if outcome != RUNNING:
        readings.append(("end", batch.outcomes[outcome]))
    tilt = float(
        np.arcsin(
            min(1.0, batch.surfaces.conditions[state, GRAVITY_ALONG] / _gravity(batch, state))
        )
    )
    name = type(batch.task).__name__
    return Scene(
        axis=batch.axes(state),
        rotor=view.rotor,
        outline=outline_of(view),
        pose=tuple(truth[:3].tolist()),
        pitch=plant.pitch,
        origin=plant.origin,
        zone=tuple(view.zone.tolist()),
        trail=trail,
        sensed_pose=tuple(sensed[:3].tolist()) if apart else None,
        goal=batch.task.goal(view),
        tilt=tilt,
        title=name if title is None else title,
        readings=tuple(readings),
    )


def _gravity(batch: Batch, state: int) -> float:
    return float(np.hypot(*batch.surfaces.conditions[state, 3:5]))


def outline_of(state: EnvState) -> NDArray[np.float64]:
    """(points, 2) [m] perimeter of the base from its centroid."""
    corners = state.corners
    if np.abs(corners).max() > 0.0:
        keep = np.ones(len(corners), dtype=bool)
        keep[1:] = (corners[1:] != corners[0]).any(axis=1)
        return corners[keep]
    return state.body[RADIUS] * np.stack([np.cos(_DISC), np.sin(_DISC)], axis=-1)
