"""Which poses to measure: candidates, D-optimal exchange, accuracy ahead, a short path."""
