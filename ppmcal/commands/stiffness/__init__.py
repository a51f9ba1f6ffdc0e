"""How far the tool gives way under load, over the workspace."""

ORDER = 14
