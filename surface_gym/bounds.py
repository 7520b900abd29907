"""What is physical: the least and the greatest that an argument may be, far from any real surface.

Within these bounds every step stays finite; beyond them squares and quotients overflow, or round
to nothing. Each bound is generous: whoever meets one has a wrong unit or a slip of the pen.
"""

import math

# [m] of a base, a pitch or a line: from a tenth of the smallest module to more than any hall.
LENGTH = (1e-4, 1e3)
# [m] of any x or y, either way: round-off there, 2e-12 m, is far below the 1e-9 m by which an
# element on a base's perimeter counts as under it.
FARTHEST = 1e4
TURNED = 1e6  # [rad] of any angle, either way: round-off there, 1e-10 rad, turns a base by nothing
SPEED = 100.0  # [m/s] either way: twenty times the fastest sorter
SPIN = 1e3  # [rad/s] either way: 10 000 revolutions a minute
FRICTION = 100.0  # [-] of any coefficient: rubber on rubber has 4
MASS = (1e-6, 1e6)  # [kg] from a grain of sand to a ship's crane
COM_HEIGHT = 100.0  # [m] of a centre of mass above its base: a tower
# [-] radius of gyration over the base's reach: of a thin mast on a wide foot, of a beam on a point
GYRATION = (1e-3, 1e3)
STIFFNESS = (1e-9, 1e9)  # [-] of an element; only ratios count
STIFFNESS_RATIO = 1e6  # [-] of the stiffest to the softest element: more than steel to foam
STIFFNESS_SPREAD = 2.0  # [-] log-normal: one element in six is 7 times as stiff as most, or more
STEP = (1e-6, 1.0)  # [s] of a simulation's time step
DURATION = (1e-9, 1e6)  # [s] of a simulation: up to eleven days
CONTROL_PERIOD = (1e-6, 10.0)  # [s]: in more than 10 s nobody controls anything
EPISODE = 86_400.0  # [s] of a flow: a day
PATIENCE = (1e-6, EPISODE)  # [s]
AHEAD = 100.0  # [s] in which a parcel has long left
RATE = (1e-6, 1e5)  # [parcels/h]: up to 28 parcels a second
ODDS = (1e-9, 1e9)  # [-] of one thing against another
AXIS_SPEED = (1e-6, 1e9)  # [rad/s] at which an axis turns, if it is not infinite
FRAME_RATE = (1e-3, 1e6)  # [Hz] of a sensor
POSITION_ERROR = 10.0  # [m] standard deviation of what a sensor says: many parcels
ANGLE_ERROR = 2.0 * math.pi  # [rad] a whole turn, of which nothing is known then
TOLERANCE = (1e-6, 1.0)  # [m] within which a switch switches
# [m^2/s^3] and [rad^2/s^3]: from a physics that never errs to one that says nothing
DENSITY = (1e-12, 1e9)
# [-] of a friction's factor and [m] of a load's place: from known to wholly unknown
LEARNED_SPREAD = (1e-6, 1.0)
FRICTION_ERROR = 10.0  # [-] share by which friction may be off
ELEMENTS = 1_000_000  # of a plant, whose lanes have arrays of as many
ORIENTATIONS = 1000  # on offer: an axis told to a fifth of a degree; "any" tells it finer
