"""Entry: what a controller knows of a parcel as it enters."""

from dataclasses import dataclass

from surface_gym import bounds, checks
from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import Array
from surface_gym.lanes.lane import Lane

ENTRY_ROWS = 2  # of noise that a start uses


@dataclass(frozen=True)
class Entry:
    """How well a controller knows pose and velocity of a parcel as it enters.

    The conveyor before the surface has a known speed and its guides align the parcel, so that the
    first estimate is the truth with Gaussian errors of these standard deviations.

    Raises:
        ValueError: a negative one, or one beyond `surface_gym.bounds`.
    """

    position: float = 0.002  # [m] in x and in y
    angle: float = 0.01  # [rad]
    speed: float = 0.05  # [m/s] in vx and in vy
    turning: float = 0.1  # [rad/s]

    def __post_init__(self) -> None:
        for name, most in (
            ("position", bounds.POSITION_ERROR),
            ("angle", bounds.ANGLE_ERROR),
            ("speed", bounds.SPEED),
            ("turning", bounds.SPIN),
        ):
            checks.not_negative(name, getattr(self, name), most)

    @property
    def settings(self) -> tuple[float, float, float, float]:
        """As compiled code reads it."""
        return (self.position, self.angle, self.speed, self.turning)


@lane_function
def enter(settings: Array, first: int, lane: Lane) -> None:
    """Write what is known of pose and velocity at a start into the first 6 of `lane.kept`.

    The Entry is in `settings` from `first` on.
    """
    row = lane.noise_row[0]
    lane.noise_row[0] = row + ENTRY_ROWS
    for k in range(3):
        pose_error = settings[first] if k < 2 else settings[first + 1]
        velocity_error = settings[first + 2] if k < 2 else settings[first + 3]
        lane.kept[k] = lane.truth[k] + pose_error * lane.noise[row, k]
        lane.kept[3 + k] = lane.truth[3 + k] + velocity_error * lane.noise[row + 1, k]
