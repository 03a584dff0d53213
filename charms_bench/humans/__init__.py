"""Human driving: recordings in highD's format, and summaries of their contents."""
