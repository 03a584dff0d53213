"""A window that shows one picture after another."""

import os

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError


class Window:
    """A window of pygame, which is installed with highway-env.

    Raises:
        InputError: There is no display.
    """

    def __init__(self, title: str) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        import pygame

        try:
            pygame.display.init()
            # Without a display, SDL draws where nobody looks, unless it was asked to.
            has_display = "SDL_VIDEODRIVER" in os.environ or (
                pygame.display.get_driver() not in ("dummy", "offscreen")
            )
        except pygame.error:
            has_display = False
        if not has_display:
            raise InputError(
                "render_mode 'human' opens a window, and there is no display; use render_mode "
                "'rgb_array', whose pictures can be recorded as a video"
            )
        pygame.display.set_caption(title)
        self._screen: pygame.Surface | None = None
        self._clock = pygame.time.Clock()

    def show(self, picture: NDArray[np.uint8], per_second: float) -> None:
        """Shows a picture (height, width, 3), at most `hz` pictures per second."""
        import pygame

        size = (picture.shape[1], picture.shape[0])
        if self._screen is None or self._screen.get_size() != size:
            self._screen = pygame.display.set_mode(size)
        pygame.surfarray.blit_array(self._screen, picture.swapaxes(0, 1))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(per_second)

    def close(self) -> None:
        """Closes the window."""
        import pygame

        pygame.display.quit()
