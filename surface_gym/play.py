"""A surface to play with: `surface-gym play`.

The keys 1 2 3 4 stand for axes at 0, 45, -45 and 90 deg. Space pauses, R starts again, Escape ends.

One parcel, with the goal of a task (--task sort, and others): press the mouse where the parcel is
to start and drag: it leaves with the speed drawn, 1 m/s for half a metre. 1 2 3 4 turn the axes of
the zone: all of them, with Shift those ahead of the parcel's centre, with Ctrl those behind it. Tab
turns the start by 15 deg, S and B choose the parcel.

A stream of parcels: with --task flow lead each to the exit of its colour; with singulate, merge and
sequence let them leave one by one. 1 2 3 4 choose an angle, and the modules that the mouse is drawn
over, pressed, turn to it; with Shift all do. + and - change how many parcels come.
"""

import argparse
import os
import subprocess
import sys

from surface_gym.cli import typed
from surface_gym.registration import PERIODS

FRAME_RATE = 25.0  # [1/s] real time at the control period of 40 ms
ANSWER = 10.0  # [s] that a display is given to answer
PROBE = "import pygame; pygame.display.init(); print(pygame.display.get_driver())"


def check_display() -> None:
    """Raise a RuntimeError unless there is a display to open a window on.

    Without one SDL shows nothing to nobody, and one that does not answer holds it up for ever: it
    is tried in a process of its own.
    """
    names = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    given = ", ".join(f"{name}={os.environ[name]}" for name in names if os.environ.get(name))
    wanted = f"play needs a display to open its window on, got {given or 'no DISPLAY'}"
    try:
        probe = subprocess.run(
            [sys.executable, "-c", PROBE], capture_output=True, text=True, timeout=ANSWER
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"{wanted}, which does not answer within {ANSWER:g} s") from None
    from surface_gym.rendering.painter import UNSEEN

    if probe.returncode or probe.stdout.split()[-1:] in [[driver] for driver in UNSEEN]:
        raise RuntimeError(wanted)


def main(arguments: list[str] | None = None) -> None:
    """Play until the player leaves."""
    parser = argparse.ArgumentParser(
        prog=typed("play"),
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--task", choices=PERIODS, default="sort", help="surface and goal")
    task = parser.parse_args(arguments).task
    try:
        check_display()
    except RuntimeError as error:
        sys.exit(f"error: {error}")
    print("opening a window; Escape ends")
    import pygame

    from surface_gym.game import Game, StreamGame, TaskGame
    from surface_gym.rendering import Window

    window = Window("Smart surface", FRAME_RATE)
    try:
        game: Game = StreamGame(task) if PERIODS[task] is None else TaskGame(task)
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
