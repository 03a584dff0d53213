"""CHARMS: its policies, its traffic and how they were trained."""
