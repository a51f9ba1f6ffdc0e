"""Results as files: plain arrays in SI become tables and JSON in the machine's units."""
