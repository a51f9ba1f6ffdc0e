"""From a wanted accuracy to tolerances, checked by Monte Carlo."""

ORDER = 13
