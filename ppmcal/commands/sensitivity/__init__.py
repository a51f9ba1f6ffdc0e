"""What each error of the geometry does to the tool."""

ORDER = 12
