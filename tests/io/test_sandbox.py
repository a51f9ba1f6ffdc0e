"""The temporary folder in which ``verify`` runs results again."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ppmcal.cli.streams import Stopped, interruptible
from ppmcal.io.sandbox import sandbox

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGTERM"), reason="signals of POSIX")


def after_signal(function: Callable[..., Any], first: bool) -> Callable[..., Any]:
    """Return a function that is sent SIGTERM before, or after, what it does."""
    def called(*args: Any, **options: Any) -> Any:
        if first:
            signal.raise_signal(signal.SIGTERM)
        result = function(*args, **options)
        if not first:
            signal.raise_signal(signal.SIGTERM)
        return result

    return called


@pytest.mark.parametrize(("module", "name", "first"), [
    (tempfile, "mkdtemp", False), (os, "unlink", True), (os, "rmdir", True)])
def test_a_signal_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: Any,
                                 name: str, first: bool) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(module, name, after_signal(getattr(module, name), first))
    with interruptible(), pytest.raises(Stopped), sandbox(str(tmp_path)) as box:
        for place in ("a", "b"):
            (box.root / place).mkdir()
            (box.root / place / "file").touch()
    assert not list(tmp_path.iterdir())
