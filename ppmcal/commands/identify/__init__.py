"""Identify the machine's geometry from measurements."""

ORDER = 7
