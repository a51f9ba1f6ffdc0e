"""A calibration certificate from results that are made again first."""

ORDER = 22
