"""The meta-actions by which a policy drives."""

import numpy as np
from numpy.typing import NDArray

ACTIONS = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")
"""The meta-actions; an action is an index into this tuple."""
LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER = range(len(ACTIONS))
Actions = NDArray[np.integer]
