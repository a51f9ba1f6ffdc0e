"""How well a calibrated machine predicts other measurements."""

ORDER = 8
