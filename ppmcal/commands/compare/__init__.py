"""Tell what changed between two calibrations of a machine."""

ORDER = 9
