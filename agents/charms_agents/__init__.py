"""CHARMS: its policies, its traffic and their training."""
