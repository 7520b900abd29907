"""Playing: what keys and mouse do, without a screen."""

from collections.abc import Iterator

import numpy as np
import pygame
import pytest

from surface_gym import play

MIDDLE = (480, 355)  # [px] about the line's middle


@pytest.fixture
def game() -> play.TaskGame:
    return play.TaskGame("sort")


def press(game: play.TaskGame, key: int, held: int = 0) -> None:
    game.take(pygame.event.Event(pygame.KEYDOWN, key=key, mod=held))


def drag(game: play.TaskGame, down: tuple[int, int], up: tuple[int, int]) -> None:
    game.take(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=down, button=1))
    game.take(pygame.event.Event(pygame.MOUSEMOTION, pos=up, rel=(0, 0), buttons=(1, 0, 0)))
    game.take(pygame.event.Event(pygame.MOUSEBUTTONUP, pos=up, button=1))


def test_a_drag_sets_place_and_speed(game: play.TaskGame) -> None:
    drag(game, MIDDLE, (MIDDLE[0] + 30, MIDDLE[1] - 30))  # an element is 30 px, y upwards
    x, y, _, vx, vy, omega = game._batch.parcels.truth[0]
    assert (x, y) == pytest.approx((1.5, 1.0), abs=0.06)
    assert (vx, vy, omega) == pytest.approx((0.2, 0.2, 0.0))


def test_keys_turn_the_axes_of_the_zone(game: play.TaskGame) -> None:
    drag(game, MIDDLE, (MIDDLE[0] + 30, MIDDLE[1]))
    zone = game._batch.view(0).obeys
    press(game, pygame.K_2)
    game.advance()
    assert game._batch.axes(0)[zone] == pytest.approx(np.pi / 4)
    press(game, pygame.K_1, pygame.KMOD_SHIFT)  # ahead of the parcel's centre alone
    game.advance()
    axes = game._batch.axes(0)
    x = 0.05 + 0.1 * np.arange(axes.shape[1])
    centre = game._batch.parcels.truth[0, 0]
    assert axes[zone & (x >= centre)] == pytest.approx(0.0)
    assert axes[zone & (x < centre)] == pytest.approx(np.pi / 4)


def test_space_pauses_and_r_starts_again(game: play.TaskGame) -> None:
    start = game._batch.parcels.truth[0].copy()
    game.advance()
    moved = game._batch.parcels.truth[0].copy()
    press(game, pygame.K_SPACE)
    game.advance()
    assert (game._batch.parcels.truth[0] == moved).all()
    press(game, pygame.K_r)
    assert (game._batch.parcels.truth[0] == start).all()


def test_tab_turns_the_start_and_letters_choose_the_parcel(game: play.TaskGame) -> None:
    press(game, pygame.K_b)
    press(game, pygame.K_TAB)
    assert game._batch.parcels.truth[0, 2] == pytest.approx(np.radians(15.0))
    assert np.abs(game._batch.view(0).corners).max() == pytest.approx(0.225)


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.mark.usefixtures("screen")
def test_escape_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    escape = pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE, mod=0)
    monkeypatch.setattr(pygame.event, "get", lambda *_: [escape] if not _ else [])
    play.main([])
