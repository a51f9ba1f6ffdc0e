"""The map of errors: where the platform was, and how far it was off."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from ppmcal.io.results.certificate import CertificateRecord
from ppmcal.linalg import Array
from ppmcal.plotting.style import figure, look, png

WIDTH, HEIGHT = 6.6, 2.9
"""Inches."""


def data_uri(record: CertificateRecord) -> str:
    """Return the map as an address that holds the picture itself."""
    with look():
        drawn = figure(WIDTH, HEIGHT)
        draw(drawn, record, (0.0, 0.0, 1.0, 1.0))
        return "data:image/png;base64," + base64.b64encode(png(drawn)).decode()


def draw(drawn: Any, record: CertificateRecord, box: tuple[float, float, float, float]) -> None:
    """Draw the map into a part of a figure: left, bottom, width, height, parts of it."""
    place = np.array([r.place for r in record.rows], dtype=float)
    size = np.array([r.error for r in record.rows], dtype=float)
    unit, views = record.units.name("length"), _views(place)
    left, bottom, width, height = box
    share = width * 0.86 / len(views)
    shown: Any = None
    for n, (a, b) in enumerate(views):
        axes = drawn.add_axes((left + n * share + 0.085 * width, bottom + 0.19 * height,
                               share - 0.10 * width, 0.72 * height))
        shown = axes.scatter(place[:, a], place[:, b], c=size, s=14, cmap="viridis", vmin=0.0)
        axes.set_xlabel(f"{'xyz'[a]}, {unit}")
        axes.set_ylabel(f"{'xyz'[b]}, {unit}")
        axes.tick_params(labelsize=7)
    bar = drawn.add_axes((left + 0.89 * width, bottom + 0.19 * height, 0.015 * width,
                          0.72 * height))
    drawn.colorbar(shown, cax=bar).set_label(f"error, {unit}")
    bar.tick_params(labelsize=7)


def _views(place: Array) -> list[tuple[int, int]]:
    """Return the pairs of coordinates to show: one of a machine in a plane, else two."""
    return [(0, 1)] if np.ptp(place[:, 2]) <= 1e-9 * (1.0 + np.ptp(place)) else [(0, 1), (0, 2)]
