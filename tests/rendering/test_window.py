import numpy as np
import pygame
import pytest

from surface_gym.rendering import Window


@pytest.fixture(autouse=True)
def dummy_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.fixture
def picture():
    return np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def test_a_window_shows_the_picture(picture):
    window = Window("Sort", frame_rate=1000.0)
    window.show(picture)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    np.testing.assert_array_equal(shown, picture)
    assert pygame.display.get_caption()[0] == "Sort"


def test_a_window_takes_the_picture_s_size(picture):
    window = Window(frame_rate=1000.0)
    window.show(picture)
    window.show(picture[:20])
    assert pygame.display.get_surface().get_size() == (64, 20)


def test_a_window_closed_by_the_user_stays_closed(picture):
    window = Window(frame_rate=1000.0)
    window.show(picture)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    window.show(picture)
    assert window.closed
    assert not pygame.display.get_init()
    window.show(picture)
    assert not pygame.display.get_init()


def test_closing_twice_does_no_harm(picture):
    window = Window(frame_rate=1000.0)
    window.show(picture)
    window.close()
    window.close()
    assert window.closed


def test_closing_a_window_never_opened_leaves_another_s_display(picture):
    open_window = Window(frame_rate=1000.0)
    open_window.show(picture)
    Window().close()
    open_window.show(picture)
    assert pygame.display.get_surface() is not None


def test_a_window_waits_for_the_next_picture_s_time(picture, monkeypatch):
    asked = []
    window = Window(frame_rate=25.0)
    monkeypatch.setattr(
        window, "_clock", type("Clock", (), {"tick": lambda _, r: asked.append(r)})()
    )
    window.show(picture)
    assert asked == [25.0]


def test_without_a_display_the_error_says_so(picture, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "no such driver")
    with pytest.raises(RuntimeError, match="a window needs a display"):
        Window().show(picture)


def test_what_is_no_picture_is_refused(picture):
    with pytest.raises(ValueError, match="picture must be an array of uint8"):
        Window().show(picture[:, :, 0])
    with pytest.raises(ValueError, match="picture must be an array of uint8"):
        Window().show(picture / 255.0)
    with pytest.raises(ValueError, match="frame_rate must be greater than 0"):
        Window(frame_rate=0.0)
