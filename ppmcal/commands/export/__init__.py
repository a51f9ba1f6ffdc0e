"""Write a machine as lines for a controller's configuration."""

ORDER = 17
