"""The games of `surface-gym play`: a parcel or a stream on a surface that a player commands."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.core.batch import BaseBatch, Batch
from surface_gym.flow.arrivals import HOUR, Steady
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.stream import Stream
from surface_gym.registration import FLOW_TASK
from surface_gym.rendering import Painter, Scene, ink
from surface_gym.scenes import Renderer
from surface_gym.state import RUNNING
from surface_gym.tasks.start import Draw, parcel_option

AXIS_KEYS = (pygame.K_1, pygame.K_2, pygame.K_3, pygame.K_4)  # the default orientations
ROLL = 3  # the choice that all modules begin with
ONLY = np.zeros(1, dtype=np.int64)  # index of a batch's only environment

DRAG_SPEED = 2.0  # [m/s] a metre dragged
TURN = math.radians(15.0)

FIRST_RATE, RATE_STEP = 1500, 500  # [parcels/h]
SLOWEST, FASTEST = 500, 9000  # [parcels/h]
LONGEST = 3600.0  # [s] of a stream
BRUSH = 0.2  # [m] from the mouse to the centres of the modules that it turns
FIRST_BRUSH = 2  # -45 deg: to the left
MORE = (pygame.K_PLUS, pygame.K_EQUALS, pygame.K_KP_PLUS)
FEWER = (pygame.K_MINUS, pygame.K_KP_MINUS)

KEY_SIZE, KEY_LINE = 20, 26  # [px] of the font that names the keys, and from line to line
ALWAYS = "Space: pause    R: again    Esc: end"


class Game(ABC):
    """A surface that a player commands by keys and mouse."""

    keys: tuple[str, ...]  # and what they do, in lines

    def __init__(self, batch: BaseBatch) -> None:
        self._renderer = Renderer(batch)
        self._painter = Painter()
        self._help: NDArray[np.uint8] | None = None
        self._paused = False
        self.over = False  # the player has left

    def advance(self) -> None:
        """Step by a control period, unless paused."""
        if not self._paused and self._advance():
            self._renderer.record(0, begins=False)

    def take(self, event: pygame.event.Event) -> None:
        """Handle an event of the window, the keyboard or the mouse."""
        if event.type == pygame.QUIT:
            self.over = True
        elif event.type != pygame.KEYDOWN:
            self._take_mouse(event)
        elif event.key == pygame.K_ESCAPE:
            self.over = True
        elif event.key == pygame.K_SPACE:
            self._paused = not self._paused
        elif event.key == pygame.K_r:
            self._restart()
        else:
            self._take_key(event.key, event.mod)

    def draw(self) -> NDArray[np.uint8]:
        """Draw the picture (height, width, 3) of now, above the keys."""
        picture = self._painter.draw(self._scene())
        if self._help is None:
            self._help = _draw_lines(self.keys, picture.shape[1])
        return np.concatenate([picture, self._help])

    def _restart(self) -> None:
        """Begin again."""
        self._place()
        self._renderer.record(0, begins=True)

    def _scene(self) -> Scene:
        """Describe what a picture of now shows."""
        return self._renderer.scene()

    def _metres(self, pixel: tuple[int, int]) -> tuple[float, float]:
        """Convert a position [px] of the mouse to (x, y) [m] on the surface."""
        return self._painter.metres(pixel, self._scene())

    @abstractmethod
    def _advance(self) -> bool:
        """Step by a control period; False where nothing may move now."""

    @abstractmethod
    def _place(self) -> None:
        """Begin an episode on the batch."""

    @abstractmethod
    def _take_mouse(self, event: pygame.event.Event) -> None:
        """Handle an event of the mouse, and ignore any other."""

    @abstractmethod
    def _take_key(self, key: int, held: int) -> None:
        """Handle a key, pressed with the modifiers `held`."""


class TaskGame(Game):
    """One parcel on the surface of a task."""

    keys = (
        "press: put the parcel there    drag: push it    Tab: turn its start    S, B: choose it",
        "1 2 3 4: axes at 0, 45, -45, 90°    Shift: ahead of the parcel    Ctrl: behind it",
        ALWAYS,
    )

    def __init__(self, task: str) -> None:
        config = EnvConfig(task, actions="halves")
        self._batch = Batch(config, 1)
        super().__init__(self._batch)
        self._batch.reset_cache.seed(0, np.random.default_rng(0))
        numbers = self._batch.reset_cache.take(ONLY)
        self._start = config.task.start(Draw(numbers, (), config.chosen_line))
        self._command = np.full((1, 2), ROLL)  # ahead of the parcel's centre, and behind
        self._pressed: tuple[float, float] | None = None  # [m] where the mouse went down
        self._restart()

    def _advance(self) -> bool:
        if self._pressed is not None:
            return False
        self._batch.step(self._command)
        return True

    def _take_mouse(self, event: pygame.event.Event) -> None:
        if event.type == pygame.MOUSEBUTTONDOWN:
            self._pressed = self._metres(event.pos)
            self._move_start(self._pressed, self._pressed)
        elif event.type == pygame.MOUSEMOTION and self._pressed is not None:
            self._move_start(self._pressed, self._metres(event.pos))
        elif event.type == pygame.MOUSEBUTTONUP:
            self._pressed = None

    def _take_key(self, key: int, held: int) -> None:
        x, y, theta = self._start.pose
        if key in AXIS_KEYS:
            choice = AXIS_KEYS.index(key)
            if not held & pygame.KMOD_CTRL:
                self._command[0, 0] = choice
            if not held & pygame.KMOD_SHIFT:
                self._command[0, 1] = choice
        elif key in (pygame.K_s, pygame.K_b):
            parcel = parcel_option("S" if key == pygame.K_s else "B")
            self._start = self._start._replace(parcel=parcel)
            self._restart()
        elif key == pygame.K_TAB:
            self._start = self._start._replace(pose=(x, y, np.add(theta, TURN)))
            self._restart()

    def _move_start(self, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """Start from where the mouse was pressed [m], with the speed of its pull to an end [m]."""
        x, y = begin
        velocity = (DRAG_SPEED * (end[0] - x), DRAG_SPEED * (end[1] - y), 0.0)
        self._start = self._start._replace(pose=(x, y, self._start.pose[2]), velocity=velocity)
        self._restart()

    def _place(self) -> None:
        self._batch.place(ONLY, self._start)
        self._batch.begin(ONLY)

    def _scene(self) -> Scene:
        scene, parcels = super()._scene(), self._batch.parcels
        if parcels.outcome[0] == RUNNING or parcels.on_rotors[0] or parcels.steps[0] > 1:
            return scene
        return replace(scene, readings=(*scene.readings[:-1], ("no start", "off the line")))


class StreamGame(Game):
    """A stream of parcels on a line with chutes or on a slope, whose modules the player turns."""

    keys = (
        "1 2 3 4: choose 0, 45, -45, 90°    press and draw: turn modules to it    "
        "with Shift: turn all    + -: more or fewer parcels",
        ALWAYS,
    )

    def __init__(self, task: str = FLOW_TASK) -> None:
        stream = EnvConfig(task).stream_task.stream
        if task == FLOW_TASK:
            stream = Stream(parcels=("S", "B"))
        # More than ever come: their times are set by the rate that the player asks for.
        stream = replace(stream, arrivals=Steady(FASTEST))
        self._config = EnvConfig(task, stream=stream, duration=LONGEST)
        self._batch = StreamBatch(self._config, 1)
        super().__init__(self._batch)
        _, rows, _, columns = self._config.site.zone
        self._choice = np.full((rows, columns), ROLL)  # of each module of the zone
        self._brush = FIRST_BRUSH  # the choice that the mouse gives
        self._rate = FIRST_RATE
        self._seed = 0
        self._restart()

    def _advance(self) -> bool:
        if self._batch.outcome[0] != RUNNING:
            return False
        self._batch.step(self._choice.reshape(1, -1))
        return True

    def _place(self) -> None:
        """Begin again with other parcels; the axes stay."""
        self._batch.seed(0, np.random.default_rng(self._seed))
        self._seed += 1
        self._batch.reset(ONLY)
        self._time_arrivals()

    def _take_mouse(self, event: pygame.event.Event) -> None:
        pressed = event.type == pygame.MOUSEBUTTONDOWN and event.button == pygame.BUTTON_LEFT
        if pressed or (event.type == pygame.MOUSEMOTION and event.buttons[0]):
            self._paint(self._metres(event.pos))

    def _take_key(self, key: int, held: int) -> None:
        if key in AXIS_KEYS:
            self._brush = AXIS_KEYS.index(key)
            if held & pygame.KMOD_SHIFT:
                self._choice[:] = self._brush
        elif key in MORE or key in FEWER:
            rate = self._rate + (RATE_STEP if key in MORE else -RATE_STEP)
            self._rate = min(FASTEST, max(SLOWEST, rate))
            self._time_arrivals()

    def _paint(self, centre: tuple[float, float]) -> None:
        """Turn the modules near a position (x, y) [m]."""
        line = self._config.chosen_line
        first_row, rows, first_column, columns = self._config.site.zone
        x = line.origin[0] + line.pitch_x * (first_column + np.arange(columns))
        y = line.origin[1] + line.pitch_y * (first_row + np.arange(rows))
        near = np.hypot(x - centre[0], (y - centre[1])[:, np.newaxis]) <= BRUSH
        self._choice[near] = self._brush

    def _time_arrivals(self) -> None:
        """Let the parcels still to come arrive one after the other at the rate asked for."""
        streams = self._batch.streams
        due, gap = int(streams.due[0]), HOUR / self._rate
        coming = streams.time[0, due:]
        last = streams.time[0, due - 1]  # the first has come at the start
        coming[:] = max(last + gap, float(streams.clock[0])) + gap * np.arange(len(coming))

    def _scene(self) -> Scene:
        scene = self._renderer.scene()
        angles = np.array(self._config.chosen_orientations)
        axis = scene.axis.copy()
        axis[scene.obeys] = angles[self._choice].ravel()  # as painted, while paused too
        readings = (
            ("mouse", f"{np.degrees(angles[self._brush]):.0f}\N{DEGREE SIGN}"),
            ("coming an hour", str(self._rate)),
            *scene.readings,
        )
        return replace(scene, axis=axis, readings=readings)


def _draw_lines(lines: Sequence[str], width: int) -> NDArray[np.uint8]:
    """Draw lines of text as a strip of a width [px]."""
    canvas = pygame.Surface((width, KEY_LINE * len(lines) + 8))
    canvas.fill(ink.PAPER)
    for k, line in enumerate(lines):
        middle = (24, KEY_LINE * k + KEY_LINE // 2)
        ink.write(canvas, line, KEY_SIZE, ink.FAINT_INK, width - 48, midleft=middle)
    return np.asarray(pygame.surfarray.array3d(canvas).swapaxes(0, 1))
