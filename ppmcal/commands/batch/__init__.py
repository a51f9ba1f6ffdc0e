"""Identify, diagnose or compensate hundreds of machines and dates."""

ORDER = 19
