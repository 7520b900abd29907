"""The simulator's own half: parcel after parcel on the package's physics, and a camera over it."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.core.actions import ANY
from surface_gym.core.batch import Batch
from surface_gym.layouts import ROLLING
from surface_gym.parcel import Base, Disc, Parcel, Polygon
from surface_gym.physics.types import COM_HEIGHT, MASS, RADIUS
from surface_gym.sensors import Exact
from surface_gym.settings import Settings
from surface_gym.state import GRAVITY_ALONG, GRAVITY_NORMAL, RUNNING, EnvState

from .axis_guard import AxisGuard
from .device import Angles, AxesTaken, Entered, Frame, Left, Message, Triple
from .sensing import camera_of
from .zone import of_zone

ONLY = np.zeros(1, dtype=np.int64)  # the lane


@dataclass(frozen=True)
class WorldOptions:
    """What a simulated machine does beside physics.

    Raises:
        ValueError: a number that is not allowed.
    """

    pause: float = 0.3  # [s] from a parcel's leaving to the next one's entering
    encoders: bool = False  # frames tell of the axes, too
    mute_every: float = 0.0  # [s] from one time that no frames come to the next; 0: they always do
    mute_for: float = 0.5  # [s] for which they do not

    def __post_init__(self) -> None:
        for name in ("pause", "mute_every", "mute_for"):
            checks.not_negative(name, getattr(self, name))


class World:
    """A surface, its parcels and a camera, in time that the caller tells.

    The physics runs ahead of the caller's clock by a step at most, so that axes told now turn no
    earlier than now. A frame is due as much later as the camera is late.

    Args:
        settings: of the environment that it stands for; its actions do not count, since axes are
            told each by itself.
        seed: of all that is drawn.
        begun: [s] by the caller's clock.
        options: of the machine.

    Raises:
        ValueError: sensors without frames.
    """

    def __init__(
        self, settings: Settings, seed: int, begun: float, options: WorldOptions = WorldOptions()
    ) -> None:
        self._camera = camera_of(settings.sensors)
        self.dt = settings.timing.dt
        self._every = self._camera.frame_steps(self.dt)
        self._latency = self._camera.latency
        if self._latency is None:
            self._latency = self._every * self.dt
        self._limit = settings.chosen_task.periods * settings.timing.steps
        self._batch = Batch(
            replace(
                settings,
                actions="modules",
                orientations=ANY,
                control_period=self.dt,
                sensors=Exact(),
                observe=(),
                observe_axes=False,
                info=(),
            ),
            1,
        )
        kind = self._batch.settings.action_kind
        self.shape = (kind.rows, kind.columns)
        self._guard = AxisGuard(self.shape, None)
        generator, self._noise = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(2))
        self._batch.seed(0, generator)
        self._options = options
        self._begun = begun
        self._now = begun
        self._step = 0
        self._number = -1
        self._present = False
        self._enters = begun + options.pause
        self._command = np.full((1, kind.size), ROLLING)

    @property
    def now(self) -> float:
        """[s] to which the physics has run."""
        return self._now

    def stand_still(self, seconds: float) -> None:
        """Let time pass in which nothing moves: the clock ran away from the physics."""
        self._now += seconds
        self._begun += seconds
        self._enters += seconds

    def set_axes(self, command: int, angles: Angles) -> AxesTaken:
        """Turn the zone's modules to angles (rows, columns) [rad]; refused where out of range."""
        fault = self._guard.fault(angles)
        if not fault:
            self._command[0] = angles.ravel()
        return AxesTaken(command, self._now, fault)

    def advance(self, until: float) -> list[tuple[float, Message]]:
        """Move on to a time [s]; what there is to say, and when [s] each of it is to be said."""
        said: list[tuple[float, Message]] = []
        while self._now <= until:
            if not self._present and self._now >= self._enters:
                said.append((self._now, self._enter()))
            if self._present:
                self._batch.advance(self._command)
            self._now += self.dt
            self._step += 1
            if self._step % self._every == 0 and not self._is_mute():
                frame = self._take()
                if frame is not None:
                    assert self._latency is not None
                    said.append((self._now + self._latency, frame))
            if self._present:
                ends = self._batch.outcome[0] != RUNNING
                if ends or self._batch.parcels.steps[0] >= self._limit:
                    said.append((self._now, self._leave(bool(ends))))
        return said

    def _enter(self) -> Entered:
        self._command[:] = ROLLING
        self._batch.start(ONLY)
        self._present = True
        self._number += 1
        state, entry = self._batch.view(0), self._camera.entry
        spread = np.array(
            [entry.position] * 2 + [entry.angle] + [entry.speed] * 2 + [entry.turning]
        )
        known = state.truth + spread * self._noise.standard_normal(6)
        return Entered(
            self._number,
            self._now,
            _seen_parcel(state),
            _triple(known[:3]),
            _triple(known[3:]),
            tuple(state.goal.tolist()),
            math.atan2(state.surface[GRAVITY_ALONG], state.surface[GRAVITY_NORMAL]),
            state.path.copy() if len(state.path) else None,
        )

    def _leave(self, ends: bool) -> Left:
        lanes, task = self._batch.parcels, self._batch.task
        self._present = False
        self._enters = self._now + self._options.pause
        outcome = self._batch.outcomes[int(lanes.outcome[0])] if ends else "out of time"
        figures = dict(zip(task.metrics, lanes.metrics[0].tolist(), strict=True))
        return Left(self._number, outcome, figures)

    def _take(self) -> Frame | None:
        """A frame, or None where it is lost."""
        camera = self._camera
        noise, lot = self._noise.standard_normal(3), self._noise.random()
        if lot < camera.drop:
            return None
        if not self._present:
            return Frame(self._now)
        spread = np.array([camera.position_noise] * 2 + [camera.angle_noise])
        pose = self._batch.parcels.truth[0, :3] + spread * noise
        axes = None
        if self._options.encoders:
            axes = of_zone(self._batch.axes(0), self._batch.view(0).zone, self.shape)
        return Frame(self._now, self._number, _triple(pose), axes)

    def _is_mute(self) -> bool:
        every = self._options.mute_every
        return every > 0.0 and (self._now - self._begun) % every > every - self._options.mute_for


def _seen_parcel(state: EnvState) -> Parcel:
    """What a picture and a scale tell of a lane's parcel: not where its load lies."""
    corners: NDArray[np.float64] = state.corners
    base: Base
    if np.ptp(corners, axis=0).max() == 0.0:
        base = Disc(float(state.body[RADIUS]))
    else:
        apart = np.abs(corners - np.roll(corners, 1, axis=0)).max(axis=1) > 0.0
        base = Polygon(corners[apart])
    return Parcel(base, mass=float(state.body[MASS]), com_height=float(state.body[COM_HEIGHT]))


def _triple(values: NDArray[np.float64]) -> Triple:
    first, second, third = values.tolist()
    return (first, second, third)
