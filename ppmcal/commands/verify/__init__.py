"""Make results again and compare them value by value."""

ORDER = 23
