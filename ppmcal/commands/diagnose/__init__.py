"""Find the effect that the model misses, name it and add it."""

ORDER = 10
