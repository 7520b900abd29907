"""Playing with a stream: what keys and mouse do, without a screen."""

from collections.abc import Iterator

import numpy as np
import pygame
import pytest

from surface_gym import play
from surface_gym.flow.memory import JAM
from surface_gym.flow.play import FASTEST, FIRST_RATE, RATE_STEP, SLOWEST, FlowGame

LEFT_TURN, RIGHT_TURN, ROLL = 2, 1, 3  # choices: -45, 45 and 90 deg


@pytest.fixture
def game() -> FlowGame:
    return FlowGame()


def press(game: FlowGame, key: int, held: int = 0) -> None:
    game.take(pygame.event.Event(pygame.KEYDOWN, key=key, mod=held))


def pixel(place: tuple[float, float]) -> tuple[int, int]:
    """[px] of a place (x, y) [m]: an element is 16 px, the line's middle 227 px down."""
    return round(96 + 160 * place[0]), round(227 - 160 * (place[1] - 1.0))


def touch(game: FlowGame, place: tuple[float, float], button: int = 1) -> None:
    where = pixel(place)
    game.take(pygame.event.Event(pygame.MOUSEBUTTONDOWN, pos=where, button=button))
    game.take(pygame.event.Event(pygame.MOUSEBUTTONUP, pos=where, button=button))


def draw_over(game: FlowGame, place: tuple[float, float], buttons: tuple[int, int, int]) -> None:
    where = pixel(place)
    game.take(pygame.event.Event(pygame.MOUSEMOTION, pos=where, rel=(0, 0), buttons=buttons))


def turned(game: FlowGame) -> np.ndarray:
    """(modules, 2) [m] centres of those that are not at 90 deg, as the scene shows them."""
    rows, columns = np.nonzero(~np.isclose(game._scene().axis, np.pi / 2))
    return np.stack([0.05 + 0.1 * columns, 0.05 + 0.1 * rows], axis=-1)


def test_the_mouse_turns_the_modules_around_it(game: FlowGame) -> None:
    place = (2.0, 1.0)
    press(game, pygame.K_2)
    touch(game, place)
    centres = turned(game)
    assert np.hypot(*(centres - place).T).max() < 0.21
    assert len(centres) == 12  # a disc of 0.2 m
    np.testing.assert_allclose(game._scene().axis[8:12, 19:21], np.pi / 4)
    game.advance()
    np.testing.assert_allclose(game._album.scene().axis, game._scene().axis)  # they have turned


def test_drawn_over_the_line_it_turns_all_on_its_way(game: FlowGame) -> None:
    touch(game, (2.0, 1.0))
    draw_over(game, (3.0, 1.0), (1, 0, 0))
    assert turned(game)[:, 0].max() == pytest.approx(3.15)
    draw_over(game, (4.0, 1.0), (0, 0, 0))  # no longer pressed
    assert turned(game)[:, 0].max() == pytest.approx(3.15)


def test_other_buttons_and_places_off_the_line_do_nothing(game: FlowGame) -> None:
    touch(game, (2.0, 1.0), button=3)
    touch(game, (2.0, 1.5))
    touch(game, (0.2, 1.0))  # the lead-in
    assert len(turned(game)) == 0


def test_shift_turns_all(game: FlowGame) -> None:
    press(game, pygame.K_1)
    assert (game._choice == ROLL).all()
    press(game, pygame.K_2, pygame.KMOD_LSHIFT)
    assert (game._choice == RIGHT_TURN).all()
    zone = game._scene().obeys
    np.testing.assert_allclose(game._scene().axis[zone], np.pi / 4)


def test_a_parcel_is_led_to_a_chute(game: FlowGame) -> None:
    press(game, pygame.K_3, pygame.KMOD_LSHIFT)  # all to the left
    while game._batch.streams.tally[0, 1:3].sum() == 0:
        game.advance()
    assert game._batch.streams.taken[0, 0] == game._settings.exits.place("left 1")


def test_the_rate_follows_plus_and_minus(game: FlowGame) -> None:
    flows = game._batch.streams
    for _ in range(50):
        game.advance()
    press(game, pygame.K_PLUS)
    due, clock = int(flows.due[0]), float(flows.clock[0])
    time = flows.time[0, due:]
    gap = 3600.0 / (FIRST_RATE + RATE_STEP)
    assert clock <= time[0] <= clock + gap
    np.testing.assert_allclose(np.diff(time), gap)
    for key, rate in ((pygame.K_KP_PLUS, FASTEST), (pygame.K_MINUS, SLOWEST)):
        for _ in range(40):
            press(game, key)
        assert dict(game._scene().readings)["coming an hour"] == str(rate)
        np.testing.assert_allclose(np.diff(flows.time[0, due:]), 3600.0 / rate)


def test_as_many_come_as_asked_for(game: FlowGame) -> None:
    for _ in range(500):  # 20 s
        game.advance()
    assert game._batch.streams.due[0] == 1 + int(20.0 * FIRST_RATE / 3600.0)


def test_space_pauses_and_one_may_draw_meanwhile(game: FlowGame) -> None:
    press(game, pygame.K_SPACE)
    clock = game._batch.streams.clock[0]
    game.advance()
    assert game._batch.streams.clock[0] == clock
    before = game.draw()
    touch(game, (2.0, 1.0))
    assert (game.draw() != before).any()


def test_r_starts_again_with_other_parcels_and_the_same_axes(game: FlowGame) -> None:
    game.advance()
    touch(game, (2.0, 1.0))
    flows = game._batch.streams
    choice, exits = game._choice.copy(), flows.exit[0].copy()
    press(game, pygame.K_r)
    assert flows.clock[0] == 0.0
    assert (flows.exit[0] != exits).any()
    assert (game._choice == choice).all()
    np.testing.assert_allclose(np.diff(flows.time[0, 1:]), 3600.0 / FIRST_RATE)


def test_a_jam_stays_until_r(game: FlowGame) -> None:
    game._batch.streams.outcome[0] = JAM
    game.advance()
    assert dict(game._scene().readings)["end"] == "jam"
    assert game._batch.streams.clock[0] == 0.0
    press(game, pygame.K_r)
    game.advance()
    assert game._batch.streams.clock[0] > 0.0


def test_letters_of_other_games_do_nothing(game: FlowGame) -> None:
    before = game.draw()
    press(game, pygame.K_TAB)
    assert (game.draw() == before).all()


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.mark.usefixtures("screen")
def test_escape_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    escape = pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE, mod=0)
    monkeypatch.setattr(pygame.event, "get", lambda *_: [escape] if not _ else [])
    play.main(["--task", "flow"])
