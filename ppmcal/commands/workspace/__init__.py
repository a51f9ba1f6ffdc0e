"""Where the machine can go, its singularities, its assembly modes."""

ORDER = 15
