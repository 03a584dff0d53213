"""The agents that CHARMS is compared with."""
