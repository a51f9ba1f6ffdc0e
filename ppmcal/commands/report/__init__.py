"""Gather output folders into one HTML page."""

ORDER = 20
