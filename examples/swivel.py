"""A kind of module of your own: driven rollers that swivel by 20 deg, and then run faster.

>>> import gymnasium as gym, surface_gym
>>> env = gym.make("SmartSurface/Sort-v0", actions="halves", modules=Swivel())
>>> env.action_space  # ahead, left and right at 1.5 m/s along the line, for both halves
Discrete(9)
"""

import math
from dataclasses import dataclass

from surface_gym.extend import MODULES, DrivenModule, Mode

AHEAD, LEFT, RIGHT = 0.0, math.radians(20.0), math.radians(-20.0)


@dataclass(frozen=True)
class Swivel(DrivenModule):
    """A driven roller that swivels; a parcel's speed along the line is the same at all angles."""

    speeds: tuple[float, ...] = (1.5,)  # [m/s] along the line
    headings: tuple[float, ...] = (AHEAD, LEFT, RIGHT)  # [rad]
    motors = 1, 1  # one moves the surface, one turns the axis

    def mode(self, heading: float, speed: float) -> Mode:
        return Mode(heading + 0.5 * math.pi, across=-speed / math.cos(heading), driven=1.0)


MODULES.register("swivel", Swivel(), replace=True)  # loading the file again registers it again
