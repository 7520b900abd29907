"""Texts, in the font that comes with pygame."""

from functools import lru_cache

import pygame

from surface_gym.rendering.palette import FAINT_INK, INK, PAPER, Colour

_SAMPLES = 2  # a pixel and direction: letters set at twice the size keep their spacing


@lru_cache(maxsize=512)
def _letters(text: str, size: int, colour: Colour, room: int | None) -> pygame.Surface:
    # A font kept would be lost when someone else calls pygame.quit(); its pictures are not.
    pygame.font.init()
    font = pygame.font.Font(None, _SAMPLES * size)
    shown = text
    while room is not None and text and font.size(shown)[0] > _SAMPLES * room:
        text = text[:-1]
        shown = text.rstrip() + "…"
    large = font.render(shown, True, colour)
    width, height = large.get_size()
    return pygame.transform.smoothscale(large, (-(-width // _SAMPLES), -(-height // _SAMPLES)))


def width_of(text: str, size: int) -> int:
    """[px] a text takes."""
    return _letters(text, size, INK, None).get_width()


def write(
    canvas: pygame.Surface,
    text: str,
    size: int,
    colour: Colour = INK,
    room: int | None = None,
    **place: tuple[int, int],
) -> pygame.Rect:
    """Write a text.

    Args:
        canvas: what to write on.
        text: what to write.
        size: [px] of the font.
        colour: of the text.
        room: [px] it may take; one that needs more is cut and ends with an ellipsis.
        place: where, as one of a pygame Rect's points, such as `midleft=(10, 20)`.

    Returns:
        The area taken.
    """
    letters = _letters(text, size, colour, room)
    area = letters.get_rect(**place)
    canvas.blit(letters, area)
    return area


def write_on_plate(
    canvas: pygame.Surface,
    text: str,
    size: int,
    colour: Colour,
    within: pygame.Rect,
    **place: tuple[int, int],
) -> None:
    """Write a text on a plate of paper, moved so that it stays within an area."""
    plate = _letters(text, size, colour, None).get_rect(**place).inflate(8, 4).clamp(within)
    sheet = pygame.Surface(plate.size, pygame.SRCALPHA)
    pygame.draw.rect(sheet, (*PAPER, 225), sheet.get_rect(), border_radius=3)
    canvas.blit(sheet, plate)
    write(canvas, text, size, colour, center=plate.center)


def write_reading(
    canvas: pygame.Surface,
    label: str,
    text: str,
    sizes: tuple[int, int],
    room: int,
    midleft: tuple[int, int],
) -> None:
    """Write a number with its label above it, the pair centred on a height."""
    x, middle = midleft
    write(canvas, label, sizes[0], FAINT_INK, room, bottomleft=(x, middle - 1))
    write(canvas, text, sizes[1], INK, room, topleft=(x, middle + 1))
