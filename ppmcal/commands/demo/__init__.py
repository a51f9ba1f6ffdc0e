"""Run the whole job once on the sample data."""

ORDER = 24
