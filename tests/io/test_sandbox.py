"""The temporary folder in which ``verify`` runs results again."""

from __future__ import annotations

import importlib
import os
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ppmcal.cli.streams import Stopped, interruptible
from ppmcal.store.runs import sandbox

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


def test_a_signal_while_a_module_loads_waits_for_it(tmp_path: Path,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    """Elsewhere the process would be left at once."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left = list[int]()
    monkeypatch.setattr(os, "_exit", left.append)
    (tmp_path / "stops_while_it_loads.py").write_text(
        "import signal\nsignal.raise_signal(signal.SIGTERM)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with interruptible(), pytest.raises(Stopped), sandbox(str(tmp_path)) as box:
        importlib.import_module("stops_while_it_loads")
        assert box.root.is_dir() and not left
        time.sleep(10.0)
    assert not list(tmp_path.glob("ppmcal-*")) and not left
