"""The data behind a calibration, kept in the machine file: noise check, end of the fit, ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

MISSED = 5.0
"""Ratio of residuals to stated noise above which the model does not fit its own data."""
CHANCE = 1e-3
"""Probability of residuals as large, below which the same is concluded."""


@dataclass(frozen=True)
class MeasurementBasis:
    """Residuals and ranges of the measurements behind a calibrated machine, and the fit's outcome.

    Attributes:
        sigma_ratio: rms of the residuals over the stated noise, nan where unknown.
        chi2_p: probability of residuals as large if model and stated noise are right.
        ranges: column -> (low, high), SI: coordinates of the platform's pose in the base frame,
            ``q_<actuator>``, and the recorded conditions.
        converged: whether the fit reached its minimum, or was stopped on purpose at the noise
            level; None if unknown.
    """

    sigma_ratio: float = float("nan")
    chi2_p: float = float("nan")
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    converged: bool | None = None

    @property
    def missed(self) -> bool:
        """Whether the model does not fit its own calibration data."""
        return self.sigma_ratio > MISSED and self.chi2_p < CHANCE
