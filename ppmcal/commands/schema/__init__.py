"""Print the JSON Schema of a file, for editors."""

ORDER = 18
