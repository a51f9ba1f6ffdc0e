"""How often `ppmcal diagnose` is right: one study over the three generators, for the docs."""
