"""Pictures: drawings as data and their interpreters, maps and curves, one style."""
