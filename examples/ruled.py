"""A sensor of your own: it reads the pose off a ruler, and the velocity off two readings.

>>> import gymnasium as gym, surface_gym
>>> env = gym.make("SmartSurface/Sort-v0", sensors=Ruled(line=0.02))
>>> observation, info = env.reset(seed=0)
"""

from dataclasses import dataclass

from surface_gym.extend import VX, Array, EnvState, Sensor, kernel_function

LINE, TURN = range(2)  # indices in the numbers
READ, WHEN = 0, 3  # indices in the sensor state: the last reading [m, m, rad], and its time [s]


@dataclass(frozen=True)
class Ruled(Sensor):
    """Rounds the pose to lines and to angles at each observation."""

    line: float = 0.005  # [m] distance of the lines, in x and in y
    turn: float = 0.02  # [rad] distance of the angles

    sensor_size = 4

    def numbers(self, dt: float) -> tuple[float, ...]:
        return (self.line, self.turn)

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        for k in range(3):
            state.sensor_state[READ + k] = _read(numbers, state, k)
        state.sensor_state[WHEN] = 0.0

    @staticmethod
    @kernel_function
    def read(numbers: Array, state: EnvState) -> None:
        passed = state.clock - state.sensor_state[WHEN]
        for k in range(3):
            reading = _read(numbers, state, k)
            moved = reading - state.sensor_state[READ + k]
            state.sensed[k] = reading
            state.sensed[VX + k] = moved / passed if passed > 0.0 else 0.0
            state.sensor_state[READ + k] = reading
        state.sensor_state[WHEN] = state.clock


@kernel_function
def _read(numbers: Array, state: EnvState, k: int) -> float:
    unit = numbers[TURN] if k == 2 else numbers[LINE]
    return unit * round(state.truth[k] / unit)
