"""When the next episodes of a vector environment start, in Gymnasium's three modes."""

from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Ints


class Autoreset:
    """Notes which of B rows wait for their next episode.

    Args:
        mode: One of Gymnasium's modes, or its value.
        count: B.
        title: The environment's name, for messages.

    Raises:
        InputError: There is no such mode.
    """

    def __init__(self, mode: AutoresetMode | str, count: int, title: str) -> None:
        try:
            self.mode = AutoresetMode(mode)
        except ValueError:
            known = ", ".join(repr(each.value) for each in AutoresetMode)
            raise InputError(
                f"{title}: autoreset_mode: {mode!r}; expected one of {known}"
            ) from None
        self._everyone = np.arange(count)
        self._waits = np.zeros(count, dtype=np.bool_)
        self.has_started = False

    def of_reset(self, mask: Any) -> Ints:
        """The rows that a reset starts: all, or those of the option `reset_mask` (B,).

        Raises:
            InputError: The mask is wrong.
            ResetNeeded: The first reset starts some rows only.
        """
        count = self._everyone.size
        chosen = np.ones(count, dtype=np.bool_) if mask is None else np.asarray(mask)
        if chosen.shape != (count,) or chosen.dtype != np.bool_ or not chosen.any():
            found = f"{chosen.dtype} of shape {chosen.shape}"
            expected = f"booleans of shape {(count,)}, of which one is true"
            raise InputError(f"reset: option 'reset_mask': {found}; expected {expected}")
        if not (self.has_started or chosen.all()):
            raise ResetNeeded("reset: the first reset starts all environments")
        self.has_started = True
        self._waits[chosen] = False
        return self._everyone[chosen]

    def before_step(self) -> Ints:
        """The rows whose next episodes start in this step, in which nothing else happens to them.

        Raises:
            ResetNeeded: There was no reset yet, or the mode leaves ended episodes to the caller.
        """
        if not self.has_started:
            raise ResetNeeded("step before the first reset")
        if self.mode == AutoresetMode.DISABLED and self._waits.any():
            ended = ", ".join(map(str, self._everyone[self._waits][:20]))
            option = "reset(options={'reset_mask': mask})"
            raise ResetNeeded(f"step: the episodes {ended} are over; start the next with {option}")
        return self._everyone[self._waits]

    def after_step(self, ended: Bools) -> Ints:
        """The rows whose next episodes start now, of those that have ended (B,)."""
        starts = self.mode == AutoresetMode.SAME_STEP
        self._waits = ended & (not starts)
        return self._everyone[ended & starts]

    def continue_all(self) -> None:
        """Notes that all rows have been given a running episode."""
        self._waits[:], self.has_started = False, True
