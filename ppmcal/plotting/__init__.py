"""Pictures: one style, maps and curves."""
