"""A window on the screen that shows pictures."""

import numpy as np
import pygame
from numpy.typing import NDArray

from surface_gym import checks


class Window:
    """Shows pictures at a frame rate, until the user or `close` closes it.

    The first picture opens it. pygame has one window per process.

    Args:
        title: of the window.
        frame_rate: [1/s] at most; `show` waits for it.

    Raises:
        ValueError: the frame rate is not positive.
    """

    def __init__(self, title: str = "Smart surface", frame_rate: float = 25.0) -> None:
        self._title = title
        self._frame_rate = checks.positive("frame_rate", frame_rate)
        self._clock = pygame.time.Clock()
        self._screen: pygame.Surface | None = None
        self.closed = False  # by the user or by `close`; it does not open again

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3) and wait until the next is due; nothing if closed.

        Raises:
            ValueError: the array is not a picture.
            RuntimeError: there is no display.
        """
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise ValueError(
                "picture must be an array of uint8 of the shape (height, width, 3), "
                f"got one of {picture.dtype} of the shape {picture.shape}"
            )
        if self.closed:
            return
        size = (picture.shape[1], picture.shape[0])
        if self._screen is None or self._screen.get_size() != size:
            self._screen = self._opened(size)
        pygame.surfarray.blit_array(self._screen, picture.swapaxes(0, 1))
        pygame.display.flip()
        self._clock.tick(self._frame_rate)
        if pygame.event.get(pygame.QUIT):
            self.close()

    def close(self) -> None:
        """Close the window; a second call does nothing."""
        self.closed = True
        if self._screen is not None:
            self._screen = None
            pygame.display.quit()

    def _opened(self, size: tuple[int, int]) -> pygame.Surface:
        try:
            pygame.display.init()
            screen = pygame.display.set_mode(size)
        except pygame.error as error:
            raise RuntimeError(f"a window needs a display: {error}") from error
        pygame.display.set_caption(self._title)
        return screen
