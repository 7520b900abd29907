"""A surface to play with: `python -m surface_gym.play`.

The keys 1 2 3 4 stand for axes at 0, 45, -45 and 90 deg. Space pauses, R starts again, Escape ends.

One parcel, with the goal of a task (--task sort, and others): press the mouse where the parcel is
to start and drag: it leaves with the speed drawn, 1 m/s for half a metre. 1 2 3 4 turn the axes of
the zone: all of them, with Shift those ahead of the parcel's centre, with Ctrl those behind it. Tab
turns the start by 15 deg, S and B choose the parcel.

A stream of parcels (--task flow): lead each to the exit of its colour. 1 2 3 4 choose an angle, and
the modules that the mouse is drawn over, pressed, turn to it; with Shift all do. + and - change how
many parcels come.
"""

import argparse
import math
import sys

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym.core.batch import Batch
from surface_gym.flow.play import FlowGame
from surface_gym.game import AXIS_KEYS, ROLL, Game
from surface_gym.picture import scene_of
from surface_gym.rendering import Painter, Scene, Window
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS
from surface_gym.tasks.base import Draw, parcel_option

FRAME_RATE = 25.0  # [1/s] real time at the control period of 40 ms
DRAG_SPEED = 2.0  # [m/s] a metre dragged
TURN = math.radians(15.0)
FLOW = "flow"


class TaskGame(Game):
    """One parcel on the surface of a task.

    Args:
        task: name of the task whose surface and goal are shown.
    """

    def __init__(self, task: str) -> None:
        super().__init__()
        settings = Settings(task, actions="halves")
        self._batch = Batch(settings, 1)
        self._batch.reserve.seed(0, np.random.default_rng(0))
        numbers = self._batch.reserve.take(np.zeros(1, dtype=np.int64))
        self._start = settings.chosen_task.start(Draw(numbers, (), settings.chosen_plant))
        self._command = np.full((1, 2), ROLL)  # ahead of the parcel's centre, and behind
        self._painter = Painter()
        self._trail: list[NDArray[np.float64]] = []
        self._pressed: tuple[float, float] | None = None  # [m] where the mouse went down
        self._restart()

    def draw(self) -> NDArray[np.uint8]:
        return self._painter.draw(self._scene())

    def _advance(self) -> None:
        if self._pressed is None:
            self._batch.advance(self._command)
            self._trail.append(self._batch.parcels.truth[0, :2].copy())

    def _take_mouse(self, event: pygame.event.Event) -> None:
        if event.type == pygame.MOUSEBUTTONDOWN:
            self._pressed = self._painter.metres(event.pos, self._scene())
            self._move_start((0.0, 0.0))
        elif event.type == pygame.MOUSEMOTION and self._pressed is not None:
            x, y = self._painter.metres(event.pos, self._scene())
            self._move_start((x - self._pressed[0], y - self._pressed[1]))
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

    def _move_start(self, pull: tuple[float, float]) -> None:
        """Start from where the mouse was pressed, with the speed of the pull [m]."""
        assert self._pressed is not None
        x, y = self._pressed
        velocity = (DRAG_SPEED * pull[0], DRAG_SPEED * pull[1], 0.0)
        self._start = self._start._replace(pose=(x, y, self._start.pose[2]), velocity=velocity)
        self._restart()

    def _restart(self) -> None:
        lane = np.zeros(1, dtype=np.int64)
        self._batch.place(lane, self._start)
        self._batch.begin(lane)
        self._trail.clear()

    def _scene(self) -> Scene:
        return scene_of(self._batch, 0, np.array(self._trail).reshape(-1, 2))


def main(arguments: list[str] | None = None) -> None:
    """Play until the player leaves."""
    parser = argparse.ArgumentParser(
        prog="python -m surface_gym.play",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--task", choices=(*TASKS, FLOW), default="sort", help="surface and goal")
    task = parser.parse_args(arguments).task
    game: Game = FlowGame() if task == FLOW else TaskGame(task)
    window = Window("Smart surface", FRAME_RATE)
    try:
        window.show(game.draw())
        while not (game.over or window.closed):
            for event in pygame.event.get():
                game.take(event)
            game.advance()
            window.show(game.draw())
    except RuntimeError as error:
        sys.exit(f"error: {error}")
    finally:
        window.close()


if __name__ == "__main__":
    main()
