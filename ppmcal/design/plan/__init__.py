"""Which poses to measure: candidates, information, exchange, path."""
