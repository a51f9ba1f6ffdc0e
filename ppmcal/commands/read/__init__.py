"""Turn files of instruments and controllers into measurements."""

ORDER = 3
