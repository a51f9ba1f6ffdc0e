"""Turn a controller's configuration into a machine and its data."""

ORDER = 2
