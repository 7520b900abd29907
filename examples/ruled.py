"""A sensor of one's own: it reads the pose off a ruler, and the velocity off two readings.

>>> import gymnasium as gym, surface_gym
>>> env = gym.make("SmartSurface/Sort-v0", sensors=Ruled(line=0.02))
>>> observation, info = env.reset(seed=0)
"""

from dataclasses import dataclass

from surface_gym.extend import VX, Array, Lane, Sensor, lane_function

LINE, TURN = range(2)  # places in the numbers
READ, WHEN = 0, 3  # places in what is kept: the last reading [m, m, rad], and its time [s]


@dataclass(frozen=True)
class Ruled(Sensor):
    """Rounds the pose to lines and to angles, whenever a controller asks."""

    line: float = 0.005  # [m] from line to line, in x and in y
    turn: float = 0.02  # [rad] from angle to angle

    kept = 4

    def numbers(self, dt: float) -> tuple[float, ...]:
        return (self.line, self.turn)

    @staticmethod
    @lane_function
    def begin(numbers: Array, lane: Lane) -> None:
        for k in range(3):
            lane.kept[READ + k] = _read(numbers, lane, k)
        lane.kept[WHEN] = 0.0

    @staticmethod
    @lane_function
    def estimate(numbers: Array, lane: Lane) -> None:
        passed = lane.clock - lane.kept[WHEN]
        for k in range(3):
            reading = _read(numbers, lane, k)
            moved = reading - lane.kept[READ + k]
            lane.sensed[k] = reading
            lane.sensed[VX + k] = moved / passed if passed > 0.0 else 0.0
            lane.kept[READ + k] = reading
        lane.kept[WHEN] = lane.clock


@lane_function
def _read(numbers: Array, lane: Lane, k: int) -> float:
    unit = numbers[TURN] if k == 2 else numbers[LINE]
    return unit * round(lane.truth[k] / unit)
