"""The agents CHARMS is compared with."""
