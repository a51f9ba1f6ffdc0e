"""Check a mechanism file, alone or with its measurements."""

ORDER = 4
