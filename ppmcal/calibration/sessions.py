"""Sessions of a campaign: its files, or what a session column says within them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.linalg import Bools
from ppmcal.model.dataset import Dataset


def session_masks(datasets: Sequence[Dataset]) -> list[tuple[str, list[Bools]]]:
    """Return label and rows, a mask (N,) by data set, of each session in order of appearance.

    A session column splits a file, and joins rows of several; without one each file is a session.
    """
    every = dict.fromkeys(label for d in datasets for label in d.sessions or [d.name])
    labels = [np.array(d.sessions) if d.sessions else None for d in datasets]
    return [(label, [np.full(len(d), d.name == label) if own is None else own == label
                     for d, own in zip(datasets, labels, strict=True)]) for label in every]


def one_session() -> BadInput:
    """Return what to say where sessions are to be left out and there is one only."""
    return BadInput("there is only one session to leave out", "--leave-out",
                    "Give several files, or a column `session`")
