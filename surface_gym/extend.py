"""Parts for tasks, sensors and lines of your own.

A task or a sensor is a frozen dataclass that inherits from `Task` or `Sensor`; `Task` and `Sensor`
say what it has to bring. Its compiled functions are static methods and `kernel_function`s:

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        return SUCCESS if state.truth[X] > state.goal[0] else RUNNING

They read and write an `EnvState`, one parcel on one surface, and may use `math`, constants, other
`kernel_function`s and what stands here:

- places in `state.truth` and `state.sensed`: `X`, `Y`, `THETA`, `VX`, `VY`, `OMEGA`;
- places in `state.body`: `RADIUS`, `COM_X`, `COM_Y`, `COM_HEIGHT`, `GYRATION`, `HALF_LENGTH`,
  `MASS`;
- places in `state.zone`: `FIRST_ROW`, `ROWS`, `FIRST_COLUMN`, `COLUMNS`;
- what `outcome` returns: `RUNNING`, `SUCCESS`, or one of `failures(outcomes)`;
- `reach_along`, `zone_start`, `zone_end`, `planar_speed`, `is_slower`, and in `is_done` also
  `read_truth`.

A task's Python half deals in `Feature`, `Draw`, `Parcels` and `Start`; `entry` is the pose at which
parcels enter a line. Lines are a `Line`, a `Field`, a `Pattern`, or a class that inherits from
`BaseLine`.
"""

from surface_gym.compiler.jit import kernel_function
from surface_gym.lines import BaseLine, Field, Line, Pattern
from surface_gym.physics.types import (
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
from surface_gym.sensors import Sensor
from surface_gym.state import (
    COLUMNS,
    FIRST_COLUMN,
    FIRST_ROW,
    ROWS,
    RUNNING,
    SUCCESS,
    EnvState,
    is_slower,
    planar_speed,
    reach_along,
    read_truth,
    zone_end,
    zone_start,
)
from surface_gym.tasks import Task
from surface_gym.tasks.base import Feature, entry, failures
from surface_gym.tasks.start import Draw, Parcels, Start, between

__all__ = [
    "COLUMNS", "COM_HEIGHT", "COM_X", "COM_Y", "FIRST_COLUMN", "FIRST_ROW", "GYRATION",
    "HALF_LENGTH", "MASS", "OMEGA", "RADIUS", "ROWS", "RUNNING", "SUCCESS", "THETA", "VX", "VY",
    "Array", "BaseLine", "Draw", "EnvState", "Feature", "Field", "Line", "Parcels", "Pattern",
    "Sensor", "Start", "Task", "X", "Y", "between", "entry", "failures", "is_slower",
    "kernel_function", "planar_speed", "reach_along", "read_truth", "zone_end", "zone_start",
]  # fmt: skip
