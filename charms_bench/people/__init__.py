"""Human driving: recordings in highD's format, and what a policy can learn from them."""
