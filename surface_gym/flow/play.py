"""A stream of parcels to play with; `surface_gym.play` tells what mouse and keys do."""

from dataclasses import replace

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.flow.arrivals import HOUR, Steady
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.picture import Album
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.game import AXIS_KEYS, ROLL, Game
from surface_gym.rendering import FlowPainter, FlowScene
from surface_gym.state import RUNNING

FIRST_RATE, RATE_STEP = 1500, 500  # [parcels/h]
SLOWEST, FASTEST = 500, 9000  # [parcels/h]
LONGEST = 3600.0  # [s] of a game
BRUSH = 0.2  # [m] from the mouse to the centres of the modules that it turns
FIRST_BRUSH = 2  # -45 deg: to the left
MORE = (pygame.K_PLUS, pygame.K_EQUALS, pygame.K_KP_PLUS)
FEWER = (pygame.K_MINUS, pygame.K_KP_MINUS)


class FlowGame(Game):
    """A stream of parcels on a line with chutes, whose modules the player turns."""

    def __init__(self) -> None:
        super().__init__()
        # More than ever come: their times are set by the rate that the player asks for.
        stream = Stream(Steady(FASTEST), parcels=("S", "B"))
        self._settings = FlowSettings(stream, duration=LONGEST)
        self._batch = FlowBatch(self._settings, 1)
        self._album = Album(self._batch, 0)
        self._painter = FlowPainter()
        _, rows, _, columns = self._settings.zone
        self._choice = np.full((rows, columns), ROLL)  # of each module of the zone
        self._brush = FIRST_BRUSH  # the choice that the mouse gives
        self._rate = FIRST_RATE
        self._seed = 0
        self._restart()

    def draw(self) -> NDArray[np.uint8]:
        return self._painter.draw(self._scene())

    def _advance(self) -> None:
        if self._batch.streams.outcome[0] == RUNNING:
            self._batch.advance(self._choice.reshape(1, -1))
            self._album.record(begins=False)

    def _restart(self) -> None:
        """Begin again with other parcels; the axes stay."""
        self._batch.seed(0, np.random.default_rng(self._seed))
        self._seed += 1
        self._batch.start(np.zeros(1, dtype=np.int64))
        self._time_arrivals()
        self._album.record(begins=True)

    def _take_mouse(self, event: pygame.event.Event) -> None:
        pressed = event.type == pygame.MOUSEBUTTONDOWN and event.button == pygame.BUTTON_LEFT
        if pressed or (event.type == pygame.MOUSEMOTION and event.buttons[0]):
            self._paint(self._painter.metres(event.pos, self._scene()))

    def _take_key(self, key: int, held: int) -> None:
        if key in AXIS_KEYS:
            self._brush = AXIS_KEYS.index(key)
            if held & pygame.KMOD_SHIFT:
                self._choice[:] = self._brush
        elif key in MORE or key in FEWER:
            rate = self._rate + (RATE_STEP if key in MORE else -RATE_STEP)
            self._rate = min(FASTEST, max(SLOWEST, rate))
            self._time_arrivals()

    def _paint(self, place: tuple[float, float]) -> None:
        """Turn the modules near a place (x, y) [m]."""
        plant = self._settings.chosen_plant
        first_row, rows, first_column, columns = self._settings.zone
        x = plant.origin[0] + plant.pitch_x * (first_column + np.arange(columns))
        y = plant.origin[1] + plant.pitch_y * (first_row + np.arange(rows))
        near = np.hypot(x - place[0], (y - place[1])[:, np.newaxis]) <= BRUSH
        self._choice[near] = self._brush

    def _time_arrivals(self) -> None:
        """Let those who are still to come do so one after the other at the rate asked for."""
        flows = self._batch.streams
        due, gap = int(flows.due[0]), HOUR / self._rate
        coming = flows.time[0, due:]
        last = flows.time[0, due - 1]  # the first has come at the start
        coming[:] = max(last + gap, float(flows.clock[0])) + gap * np.arange(len(coming))

    def _scene(self) -> FlowScene:
        scene = self._album.scene()
        angles = np.array(self._settings.chosen_orientations)
        axis = scene.axis.copy()
        axis[scene.obeys] = angles[self._choice].ravel()  # as painted, while paused too
        turned = np.degrees(angles[self._brush])
        return replace(
            scene,
            axis=axis,
            readings=(
                ("mouse", f"{turned:.0f}\N{DEGREE SIGN}"),
                ("coming an hour", str(self._rate)),
                *scene.readings,
            ),
        )
