"""From where on driving counts as critical: in compiled code and in metrics alike."""

CONFLICT_TTC_S = 1.5
"""A shorter time to collision is a conflict (Gettman & Head 2003)."""
DRAC_LIMIT_MPS2 = 3.35
"""A driver cannot be relied on to brake harder (Archer 2005)."""
HARD_BRAKING_MPS2 = 2.0
"""highway-env's limit for the braking that a lane change imposes (MOBIL)."""
LANE_KEEPING_M, DRIFT_MPS = 0.25, 0.1
"""A vehicle that moves out of its lane is further from the lane's middle, and moves away from it
faster. They ignore the swaying of vehicles that keep their lane; this project's choice."""
ENTERED_S = 2.0
"""A vehicle that came into the way of another one longer ago is a leader like any other; this
project's choice."""
HARSH_MPS2 = 2.5
"""The paper's threshold for a harsh acceleration."""
