"""What is learned is kept only where poses that taught nothing surely gain by it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from ppmcal.diagnosis import learned_terms as module
from ppmcal.diagnosis.held_out_gap import Gap


@pytest.mark.parametrize(("interval", "kept"), [((-0.32, 0.34), False), ((0.05, 0.34), True)])
def test_a_gap_that_may_not_be_closed_at_all_keeps_no_term(
        monkeypatch: pytest.MonkeyPatch, interval: tuple[float, float], kept: bool) -> None:
    """However sure the poses are that the terms were chosen with."""
    held = Gap(1.0, 17.1, 16.0, 0.07, interval, kept, False, 19)
    sure = Gap(1.0, 27.0, 8.0, 0.71, (0.68, 0.73), True, False, 70)
    learned: Any = SimpleNamespace(terms=(), curves=())
    fit: Any = SimpleNamespace(keep=(), outliers=())
    monkeypatch.setattr(module, "measure_gap", lambda *_: held)
    monkeypatch.setattr(module, "_fitted", lambda *_: (learned, None, fit))
    monkeypatch.setattr(module, "_JudgedRows", lambda *_: SimpleNamespace(seen=None))
    monkeypatch.setattr(module, "_pose_folds", lambda *_: [])
    monkeypatch.setattr(module, "_left_out", lambda *_: sure)
    monkeypatch.setattr(module, "_block_gaps", lambda *_: [])
    monkeypatch.setattr(module, "_as_well", lambda *_: ())
    monkeypatch.setattr(module, "sized_again", lambda *_: ())
    given: Any = (fit, fit, learned, (), False, None, 1.0, 1, None)
    assert (module._judged(*given) is not None) == kept
