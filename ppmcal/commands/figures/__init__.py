"""Figures and tables of output folders as files for papers."""

ORDER = 21
