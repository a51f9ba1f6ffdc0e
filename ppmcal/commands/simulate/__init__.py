"""Simulate measurements of a machine with injected errors."""

ORDER = 6
