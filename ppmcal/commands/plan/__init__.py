"""Which poses to measure."""

ORDER = 16
