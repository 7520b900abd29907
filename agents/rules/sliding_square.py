"""What a period of some axes does to a parcel's motion: the friction model, roughly."""

import numpy as np

from surface_gym.physics.types import GRAVITY
from surface_gym.tasks.line import BRAKING

from .lane_rule import Numbers
from .modules import Motion, Places


class SlidingSquare:
    """Evenly loaded squares on modules, with Coulomb friction along the modules' axes.

    Args:
        places: of the modules, taken to stay where they are under the parcel.
        half_length: (lanes,) [m] of the base.
        tilt: (lanes,) [rad] of the surface, downhill towards +x.
    """

    def __init__(self, places: Places, half_length: Numbers, tilt: Numbers) -> None:
        self._x, self._y = places.x[:, np.newaxis], places.y[:, np.newaxis]
        self._gyration = (2.0 / 3.0 * half_length**2)[:, np.newaxis]  # [m^2] of a square
        share = places.under / np.maximum(1, places.under.sum(axis=1))[:, np.newaxis]
        self._braking = BRAKING * share[:, np.newaxis]  # [m/s^2] of each module
        self._pull = (GRAVITY * np.sin(tilt))[:, np.newaxis]

    def after(self, motion: Motion, angles: Numbers, period: float, steps: int) -> Motion:
        """The motion a period on, in (lanes, ways).

        Args:
            motion: now.
            angles: (ways, modules) or (lanes, ways, modules) [rad] axes to predict for.
            period: [s] predicted.
            steps: that it is cut into.
        """
        dt = period / steps
        cosine, sine = np.cos(angles), np.sin(angles)
        arm = self._x * sine - self._y * cosine  # [m] of each axis about the centre
        # Friction grows to its most over the speed that a step of it takes: it overshoots none.
        soft = BRAKING * dt * (1.0 + arm**2 / self._gyration[..., np.newaxis])
        vx, vy, omega = (v[:, np.newaxis] for v in (motion.vx, motion.vy, motion.omega))
        for _ in range(steps):
            slip = (
                vx[..., np.newaxis] * cosine
                + vy[..., np.newaxis] * sine
                + omega[..., np.newaxis] * arm
            )
            taken = dt * self._braking * np.clip(slip / soft, -1.0, 1.0)
            vx = vx + dt * self._pull - (taken * cosine).sum(axis=-1)
            vy = vy - (taken * sine).sum(axis=-1)
            omega = omega - (taken * arm).sum(axis=-1) / self._gyration
        return Motion(vx, vy, omega)
