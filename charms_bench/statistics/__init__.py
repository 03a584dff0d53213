"""Intervals, paired comparisons, corrections for multiple tests, and divergences."""
