"""Noise that is not as its file says."""

from __future__ import annotations

import numpy as np
from odd_campaign import SIGMA, Campaign


def noise_far(c: Campaign) -> None:
    """Far away readings scatter up to five times as much."""
    c.seen += 4.0 * SIGMA * np.abs(c.away(0))[:, None] * c.rng.standard_normal(c.seen.shape)


def noise_late(c: Campaign) -> None:
    """In the second half readings scatter four times as much."""
    half = len(c.seen) // 2
    c.seen[half:] += 4.0 * SIGMA * c.rng.standard_normal(c.seen[half:].shape)


def noise_of_joints(c: Campaign) -> None:
    """All joints scatter."""
    c.joints += 2.0 * SIGMA * c.rng.standard_normal(c.joints.shape)


def noise_along(c: Campaign) -> None:
    """Readings scatter along one slanted direction: the beam of a tracker."""
    c.seen += 4.0 * SIGMA * c.rng.standard_normal((len(c.seen), 1)) * np.array([0.6, 0.8, 0.0])


def noise_loaded(c: Campaign) -> None:
    """Under load readings scatter five times as much."""
    c.seen += 0.5 * SIGMA * c.payload[:, None] * c.rng.standard_normal(c.seen.shape)


def few_digits(c: Campaign) -> None:
    """Places are read to 0.1 mm."""
    c.seen = np.round(c.seen, 1)


def scatter_by_way(c: Campaign) -> None:
    """After long moves readings scatter more: the platform still swings."""
    way = np.linalg.norm(np.diff(c.place, axis=0, prepend=c.place[:1]), axis=1)
    c.seen += 4.0 * SIGMA * (way / way.max())[:, None] * c.rng.standard_normal(c.seen.shape)
