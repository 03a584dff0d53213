"""The figures of a report, one per module."""
