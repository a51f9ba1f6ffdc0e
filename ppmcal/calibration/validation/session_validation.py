"""Each session of a campaign predicted by a fit of the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import FitOptions, Problem, identify, with_noise
from ppmcal.calibration.validation.residual_vectors import LEFT_OUT, Residuals, on_other_rows
from ppmcal.linalg import Bools
from ppmcal.model.dataset import Dataset
from ppmcal.model.sessions import one_session, session_masks
from ppmcal.wording.progress import stage


@stage("predicting each session")
def sessions_left_out(problem: Problem, options: FitOptions, keep: Sequence[Bools], noise: float
                      ) -> tuple[dict[str, dict[str, float]], str]:
    """Return the figures of every session as a fit of the others predicts it, and how.

    Frame and target of a session that is a whole file are registered anew.

    Args:
        problem: machine and all data.
        options: of the fits.
        keep: rows that count, by data set.
        noise: factor on the stated one, as in the fit to everything.

    Raises:
        BadInput: there is one session only.
        NoResult: a fit of the others does not converge.
    """
    masks = session_masks(problem.datasets)
    if len(masks) < 2:
        raise one_session()
    found: list[tuple[Residuals, list[Bools]]] = []
    for rest, own in other_sessions(problem.datasets, keep):
        fit = with_noise(identify(replace(problem, datasets=rest), options), noise, options)
        found.append(on_other_rows(fit, own))
    whole = Residuals(*(tuple(x for r, _ in found for x in getattr(r, name)) for name in (
        "vector", "sigma", "position", "rotation", "closure")))
    return whole.figures([k for _, rows in found for k in rows]), (
        f"{len(masks)} sessions ({', '.join(label for label, _ in masks)}), each predicted by a "
        "fit of the others; the final fit uses all")


def other_sessions(datasets: Sequence[Dataset], keep: Sequence[Bools],
                   judged: Sequence[Bools] | None = None
                   ) -> Iterator[tuple[tuple[Dataset, ...], list[Dataset]]]:
    """Yield for each session the data of all others, and its own; of one that is all: nothing.

    Args:
        datasets: the campaign.
        keep: rows that count (N,), by data set.
        judged: rows that count where a session is what the others predict; None: the same.
    """
    used, own = (tuple(d.without(~k, LEFT_OUT) for d, k in zip(datasets, rows, strict=True))
                 for rows in (keep, keep if judged is None else judged))
    masks = session_masks(datasets)
    for _, mask in masks if len(masks) > 1 else ():
        rest = tuple(_known_alone(d.take(~m), mask, datasets)
                     for d, m in zip(used, mask, strict=True) if not m.all())
        yield rest, _taken(own, mask)


def _taken(datasets: Sequence[Dataset], mask: Sequence[Bools]) -> list[Dataset]:
    """Return the usable rows of a session; a part of a file keeps the frame of the others."""
    out = []
    for data, m in zip(datasets, mask, strict=True):
        usable = m & np.array([not u for u in data.unusable or [""] * len(data)])
        if usable.any():
            part = data.take(usable)
            out.append(part if m.all() else replace(
                part, frame=replace(part.frame, same_as=data.name)))
    return out


def _known_alone(data: Dataset, mask: Sequence[Bools], datasets: Sequence[Dataset]) -> Dataset:
    """Return a data set with a frame of its own where that of a session left out was its."""
    gone = {d.name for d, m in zip(datasets, mask, strict=True) if m.all()}
    return data.alone() if data.frame.same_as in gone else data
