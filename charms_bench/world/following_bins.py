"""What counts as following a leader, and the bins in which quantities of followers are counted.

The same for simulated drivers and for recorded ones.
"""

from typing import Any

import numpy as np
from numba.extending import register_jitable

FOLLOWING_RANGE_M = 50.0
"""A vehicle follows a leader that is at most this far ahead, centre to centre."""
BIN = 0.5
"""Width of a bin: m/s for speeds, m for headways."""
BINS = 100
"""Number of bins; the last bin has no upper edge."""
QUANTITIES = ("speed", "dhw")


@register_jitable
def bins_of(values: Any) -> Any:
    """Returns the bin of each value; compiled code calls it with a number."""
    return np.int64(np.minimum(np.maximum(values / BIN, 0), BINS - 1))
