"""What a game on any surface is: time goes on, and the player's events do something."""

from abc import ABC, abstractmethod

import numpy as np
import pygame
from numpy.typing import NDArray

AXIS_KEYS = (pygame.K_1, pygame.K_2, pygame.K_3, pygame.K_4)  # the default orientations
ROLL = 3  # the one that all modules begin with


class Game(ABC):
    """What is played, and what a player's events do to it."""

    def __init__(self) -> None:
        self._paused = False
        self.over = False  # the player has left

    def advance(self) -> None:
        """Move on by a control period, unless paused."""
        if not self._paused:
            self._advance()

    def take(self, event: pygame.event.Event) -> None:
        """Do what an event asks for."""
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

    @abstractmethod
    def draw(self) -> NDArray[np.uint8]:
        """The picture (height, width, 3) of now."""

    @abstractmethod
    def _advance(self) -> None:
        """Move on by a control period, if there is any reason to."""

    @abstractmethod
    def _restart(self) -> None:
        """Begin again."""

    @abstractmethod
    def _take_mouse(self, event: pygame.event.Event) -> None:
        """Do what an event of the mouse asks for; any other is none of the game's."""

    @abstractmethod
    def _take_key(self, key: int, held: int) -> None:
        """Do what a key asks for, with those held that `held` tells."""
