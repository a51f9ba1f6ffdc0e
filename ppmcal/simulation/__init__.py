"""Measurements of a machine with injected errors."""
