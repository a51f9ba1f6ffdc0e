"""Inverse, forward or velocity kinematics of a table."""

ORDER = 5
