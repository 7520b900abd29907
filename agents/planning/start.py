"""The start that an observation shows: what the planner takes for the truth."""

import math

import numpy as np
from numpy.typing import NDArray

from surface_gym.lines import Field
from surface_gym.parcel import Parcel
from surface_gym.settings import Settings
from surface_gym.state import PATH_POINTS
from surface_gym.tasks.base import Start
from surface_gym.tasks.line import zone_span
from surface_gym.tasks.orient import Orient
from surface_gym.tasks.slow import Slow
from surface_gym.tasks.sort import Sort
from surface_gym.tasks.stop import Stop
from surface_gym.tasks.track import AHEAD

from ..sight import LineSight, PathSight, line_sight, path_sight

# On a field all places are alike but for that within a pitch: the parcel is put beside one module.
_COLUMN, _ROW = 10, 10
FIELD_ZONE = (6, 25)  # columns that a search may take a parcel over from there
_PIECE = 0.007  # [m] along x, of the path as rebuilt
_BEHIND = 60  # pieces of it behind the parcel


def start_of(settings: Settings, observation: NDArray[np.float32]) -> Start:
    """The start that an observation (features,) shows, the parcel one of those the task draws."""
    seen = observation[np.newaxis]
    if isinstance(settings.chosen_plant, Field):
        return _on_field(settings, path_sight(settings, seen))
    return _on_line(settings, line_sight(settings, seen))


def nearest_parcel(settings: Settings, half_length: float) -> Parcel:
    """Of the parcels that the task draws, the one nearest in size to a half length [m]."""
    parcels: tuple[Parcel, ...] = settings.chosen_task.parcels
    return min(parcels, key=lambda parcel: abs(_half_length(parcel) - half_length))


def _half_length(parcel: Parcel) -> float:
    """[m] from the base's centroid to its rearmost point, as the sensors show it."""
    return parcel.rear + parcel.base.centroid[0]


def _on_line(settings: Settings, see: LineSight) -> Start:
    task, plant = settings.chosen_task, settings.chosen_plant
    assert isinstance(task, (Sort, Slow, Stop, Orient))
    parcel = nearest_parcel(settings, float(see.half_length[0]))
    x = zone_span(plant, parcel, settings.zone)[0] + float(see.into_zone[0])
    pose = (x, plant.line_y + float(see.offset[0]), float(see.theta[0]))
    velocity = (float(see.vx[0]), float(see.vy[0]), float(see.omega[0]))
    if isinstance(task, Sort):
        goal: tuple[float, ...] = (float(see.side[0]),)
    elif isinstance(task, Slow):
        goal = (float(see.ratio[0]), float(see.entry_speed[0]))
    elif isinstance(task, Stop):
        goal = (x + float(see.to_go[0]),)
    else:
        goal = (float(see.angle[0]),)
    return Start(parcel, pose, velocity, goal)


def _on_field(settings: Settings, see: PathSight) -> Start:
    plant = settings.chosen_plant
    x = plant.origin[0] + plant.pitch_x * _COLUMN + float(see.x_in_pitch[0])
    y = plant.origin[1] + plant.pitch_y * _ROW + float(see.y_in_pitch[0])
    # The centre is over the middle of a piece, beyond what is seen the path goes on straight.
    from_centre = _PIECE * (np.arange(PATH_POINTS) - _BEHIND - 0.5)
    slope = np.interp(from_centre[:-1] + 0.5 * _PIECE, AHEAD, see.slope[0])
    path = np.concatenate([[0.0], np.cumsum(_PIECE * slope)])
    on_path = y - float(see.cross_error[0]) * math.sqrt(1.0 + float(see.slope[0, 0]) ** 2)
    path += on_path - 0.5 * (path[_BEHIND] + path[_BEHIND + 1])
    vx, vy = see.velocity
    return Start(
        nearest_parcel(settings, float(see.half_length[0])),
        (x, y, float(see.theta[0])),
        (float(vx[0]), float(vy[0]), float(see.omega[0])),
        (float(see.asked_speed[0]), x + float(from_centre[0]), _PIECE),
        float(see.tilt[0]),
        path,
    )
