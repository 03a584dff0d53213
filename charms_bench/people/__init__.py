"""Human driving: recordings in highD's format, and what they hold."""
