"""Parts for custom tasks, sensors and lines.

A task or a sensor is a frozen dataclass that inherits from `Task` or `Sensor`; these classes
describe the required parts. Its compiled functions are static methods and `kernel_function`s:

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        return SUCCESS if state.truth[X] > state.goal[0] else RUNNING

They read and write an `EnvState`, the view of one parcel on one surface. They may use `math`,
constants, other `kernel_function`s, and:

- indices into `state.truth` and `state.sensed`: `X`, `Y`, `THETA`, `VX`, `VY`, `OMEGA`;
- indices into `state.body`: `RADIUS`, `COM_X`, `COM_Y`, `COM_HEIGHT`, `GYRATION`, `HALF_LENGTH`,
  `MASS`;
- indices into `state.zone`: `FIRST_ROW`, `ROWS`, `FIRST_COLUMN`, `COLUMNS`;
- results of `outcome`: `RUNNING`, `SUCCESS`, or one of `failures(outcomes)`;
- `show`, `show_within` and `show_bent`, which write a value into a column of an observation;
  `columns(features)` returns the columns;
- `draw_line`, which draws a line of a goal on the `Canvas` of a picture;
- `reach_along`, `zone_start`, `zone_end`, `planar_speed`, `is_slower`, and in `is_done` also
  `read_truth`.

A sensor that reports more than pose and velocity has a `Group` for the other quantities; `Exact`
may be its base class. Its `update` gets a `Physics`, the physical model for predictions.

The Python part of a task uses `Feature`, `Draw`, `Parcels` and `Start`; `entry` returns the pose of
parcels at their entry. A line is a `Line`, a `Field`, a `Pattern`, or an instance of a subclass of
`BaseLine`.

A task on a stream of parcels inherits from `StreamTask`. Its functions may also use:

- indices into `state.goal`: `EXIT`, `SIDE`, `FIRST`, `LAST`, `INLET`, `ORDER`; the task's own
  indices begin at `GOALS`;
- indices into `state.memory`: `TOUCHED`; the task's own indices begin at `OWN_MEMORY`;
- the result of `exit_taken` between exits: `BETWEEN`;
- arguments of `reward`: `RUNNING`, `DEPARTED_CORRECT` or `DEPARTED_WRONG`.

Its `terms` end in `SURFACE_TERMS`. Its Python part uses a `Stream` with arrivals `Steady`,
`Spread`, `Poisson`, `Schedule` or `Trace`; `Exits` of `Exit`; and `Inlets` of `Inlet`. `flow_line`
and `slope_line` make its surface.

A kind of module is a frozen dataclass that inherits from `DrivenModule`, or from `ModuleKind`. It
returns the `Mode` of each choice. An environment takes it as `modules=`; `MODULES` gives it a name.
In a task's functions, `is_driven` returns whether a parcel at rest may move again.

`register` gives a task a name.
"""

from surface_gym.canvas import Canvas, draw_line
from surface_gym.compiler.jit import kernel_function
from surface_gym.flow.arrivals import Poisson, Schedule, Spread, Steady, Trace
from surface_gym.flow.base import SURFACE_TERMS, StreamTask
from surface_gym.flow.exits import Exit, Exits, Inlet, Inlets, flow_line
from surface_gym.flow.state import (
    BETWEEN,
    DEPARTED_CORRECT,
    DEPARTED_WRONG,
    EXIT,
    FIRST,
    GOALS,
    INLET,
    LAST,
    ORDER,
    OWN_MEMORY,
    SIDE,
    TOUCHED,
    SurfaceView,
)
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import slope_line
from surface_gym.lines import BaseLine, Field, Line, Pattern
from surface_gym.modules import MODULES, DrivenModule, Mode, ModuleKind
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
from surface_gym.registration import register
from surface_gym.sensors import Exact, Sensor
from surface_gym.sensors.base import Group, Physics, Singles
from surface_gym.state import (
    COLUMNS,
    FIRST_COLUMN,
    FIRST_ROW,
    ROWS,
    RUNNING,
    SUCCESS,
    EnvState,
    is_driven,
    is_slower,
    planar_speed,
    reach_along,
    read_truth,
    zone_end,
    zone_start,
)
from surface_gym.tasks import Task
from surface_gym.tasks.base import entry, failures
from surface_gym.tasks.features import Feature, columns, show, show_bent, show_within
from surface_gym.tasks.start import Draw, Parcels, Start, between

__all__ = [
    "BETWEEN", "COLUMNS", "COM_HEIGHT", "COM_X", "COM_Y", "DEPARTED_CORRECT", "DEPARTED_WRONG",
    "EXIT", "FIRST", "FIRST_COLUMN", "FIRST_ROW", "GOALS", "GYRATION", "HALF_LENGTH", "INLET",
    "LAST", "MASS", "MODULES", "OMEGA", "ORDER", "OWN_MEMORY", "RADIUS", "ROWS", "RUNNING", "SIDE",
    "SUCCESS", "SURFACE_TERMS", "THETA", "TOUCHED", "VX", "VY", "Array", "BaseLine", "Canvas",
    "Draw", "DrivenModule", "EnvState", "Exact", "Exit", "Exits", "Feature", "Field", "Group",
    "Inlet", "Inlets", "Line", "Mode", "ModuleKind", "Parcels", "Pattern", "Physics", "Poisson",
    "Schedule", "Sensor", "Singles", "Spread", "Start", "Steady", "Stream", "StreamTask",
    "SurfaceView", "Task", "Trace", "X", "Y", "between", "columns", "draw_line", "entry",
    "failures", "flow_line", "is_driven", "is_slower", "kernel_function", "planar_speed",
    "reach_along", "read_truth", "register", "show", "show_bent", "show_within", "slope_line",
    "zone_end", "zone_start",
]  # fmt: skip
