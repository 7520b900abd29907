"""What a task, a sensor or a plant of one's own is made of.

A task or a sensor is a frozen dataclass that inherits from `Task` or `Sensor`; `Task` and `Sensor`
say what it has to bring. Its compiled functions are static methods and `lane_function`s:

    @staticmethod
    @lane_function
    def judge(lane: Lane) -> int:
        return SUCCESS if lane.truth[X] > lane.goal[0] else RUNNING

They read and write a `Lane`, one parcel on one surface, and may use `math`, constants, other
`lane_function`s and what stands here:

- places in `lane.truth` and `lane.sensed`: `X`, `Y`, `THETA`, `VX`, `VY`, `OMEGA`;
- places in `lane.body`: `RADIUS`, `COM_X`, `COM_Y`, `COM_HEIGHT`, `GYRATION`, `HALF_LENGTH`,
  `MASS`;
- places in `lane.zone`: `FIRST_ROW`, `ROWS`, `FIRST_COLUMN`, `COLUMNS`;
- what `judge` returns: `RUNNING`, `SUCCESS`, or one of `failures(outcomes)`;
- `reach_along`, `zone_start`, `zone_end`, `speed_of`, `is_slower`, and `read_truth` for `over`.

A task's Python half deals in `Feature`, `Draw`, `Parcels` and `Start`; `entry` is the pose at which
parcels enter a line. Plants are a `Line`, a `Field`, a `Pattern`, or a class that inherits from
`Plant`.
"""

from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import (
    COM_HEIGHT,
    COM_X,
    COM_Y,
    GYRATION,
    HALF_LENGTH,
    MASS,
    OMEGA,
    RADIUS,
    THETA,
    VX,
    VY,
    Array,
    X,
    Y,
)
from surface_gym.lanes.lane import (
    Lane,
    is_slower,
    reach_along,
    read_truth,
    speed_of,
    zone_end,
    zone_start,
)
from surface_gym.lanes.memory import COLUMNS, FIRST_COLUMN, FIRST_ROW, ROWS, RUNNING, SUCCESS
from surface_gym.plants import Field, Line, Pattern, Plant
from surface_gym.sensors import Sensor
from surface_gym.tasks import Task
from surface_gym.tasks.line import entry
from surface_gym.tasks.start import Draw, Parcels, Start, between
from surface_gym.tasks.task import Feature, failures

__all__ = [
    "COLUMNS",
    "COM_HEIGHT",
    "COM_X",
    "COM_Y",
    "FIRST_COLUMN",
    "FIRST_ROW",
    "GYRATION",
    "HALF_LENGTH",
    "MASS",
    "OMEGA",
    "RADIUS",
    "ROWS",
    "RUNNING",
    "SUCCESS",
    "THETA",
    "VX",
    "VY",
    "Array",
    "Draw",
    "Feature",
    "Field",
    "Lane",
    "Line",
    "Parcels",
    "Pattern",
    "Plant",
    "Sensor",
    "Start",
    "Task",
    "X",
    "Y",
    "between",
    "entry",
    "failures",
    "is_slower",
    "lane_function",
    "reach_along",
    "read_truth",
    "speed_of",
    "zone_end",
    "zone_start",
]
