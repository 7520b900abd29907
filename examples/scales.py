"""A sensor of another quantity: scales in front of the surface, which weigh each entering parcel.

>>> import surface_gym as sg
>>> env = sg.SmartSurfaceEnv("sort", sensors=Scales(error=0.05), observe=("weight",))
>>> observation, _ = env.reset(seed=0, options={"parcel": "S"})
>>> [feature.name for feature in env.config.features][-2:]
['mass', 'moment of inertia']
>>> mass = COLUMN.mass.of(observation[-2:])
>>> bool(abs(mass - env.batch.parcel(0).mass) < 0.2)  # [kg]
True
"""

from collections.abc import Mapping
from dataclasses import dataclass

import surface_gym.extend as own
from surface_gym.extend import GYRATION, MASS, Array, EnvState, Singles, kernel_function

WEIGHT = (
    own.Feature("mass", -10.0, 1000.0, "as weighed", "kg", scale=10.0),
    own.Feature("moment of inertia", -10.0, 1000.0, "of that mass, spread evenly", "kg m^2"),
)
COLUMN = own.columns(WEIGHT)


@dataclass(frozen=True)
class Scales(own.Exact):
    """A sensor of the exact motion, and of the parcel's mass, weighed once with a random error."""

    error: float = 0.1  # [kg] standard deviation

    sensor_size = 1  # the mass [kg] that was read

    def numbers(self, dt: float) -> tuple[float, ...]:
        return (self.error,)

    def draws(self, dt: float, steps: int) -> int:
        return 1

    @property
    def groups(self) -> Mapping[str, own.Group]:
        return {**super().groups, "weight": own.Group(WEIGHT, self.show_weight)}

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        row = state.noise_row[0]
        state.noise_row[0] = row + 1
        state.sensor_state[0] = state.body[MASS] + numbers[0] * state.noise[row, 0]

    @staticmethod
    @kernel_function
    def show_weight(numbers: Array, state: EnvState, see: Singles, mirror: float) -> None:
        mass = state.sensor_state[0]
        own.show_within(see, COLUMN.mass, mass)
        own.show_within(see, COLUMN.moment_of_inertia, mass * state.body[GYRATION])
