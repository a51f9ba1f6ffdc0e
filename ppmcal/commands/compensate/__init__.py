"""Turn wanted poses into corrected commands."""

ORDER = 11
