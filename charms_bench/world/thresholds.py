"""From where on driving counts as critical: in compiled code and in metrics alike."""

CONFLICT_TTC_S = 1.5
"""A shorter time to collision is a conflict (Gettman & Head 2003)."""
DRAC_LIMIT_MPS2 = 3.35
"""A driver cannot be relied on to brake harder (Archer 2005)."""
HARD_BRAKING_MPS2 = 2.0
"""highway-env's limit for the braking that a lane change imposes (MOBIL)."""
HARSH_MPS2 = 2.5
"""The paper's threshold for a harsh acceleration."""
