"""A temporary folder in which a run is done again, with its own paths."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput, cleaned_up, uninterrupted

RESULTS = "results.of.verify"
"""Folder within the sandbox's root for what a run writes, where nothing says more of it."""


@dataclass(frozen=True)
class Sandbox:
    """A temporary folder that stands for the whole file system while a run is done again.

    The run's own paths hold in it: relative ones from its working folder, absolute ones from its
    root. So what comes out names the same paths, once the root's own is taken away.

    Attributes:
        root: the folder.
        base: the working folder that it stands for, absolute.
    """

    root: Path
    base: str

    @property
    def cwd(self) -> Path:
        """The working folder."""
        return self.place(self.base)

    def place(self, path: str) -> Path:
        """Return where a path of the run is within."""
        whole = Path(os.path.normpath(os.path.join(self.base, path)))
        return self.root / whole.relative_to(whole.anchor)

    def inside(self, value: Any) -> Any:
        """Return an option as it is said within: absolute paths below the root.

        Raises:
            BadInput: a relative path leads out of it.
        """
        if isinstance(value, list):
            return [self.inside(v) for v in value]
        if not isinstance(value, str) or not value:
            return value
        if os.path.isabs(value):
            return str(self.place(value))
        if not Path(os.path.normpath(self.cwd / value)).is_relative_to(self.root):
            raise BadInput("leads out of the folder of the run", value, "Run the command by hand")
        return value

    def lay_out(self, inputs: Mapping[str, Path]) -> None:
        """Put the inputs where the run had them."""
        self.cwd.mkdir(parents=True, exist_ok=True)
        for path, here in inputs.items():
            there = self.place(path)
            there.parent.mkdir(parents=True, exist_ok=True)
            if there.exists():
                continue
            try:
                there.symlink_to(here.absolute())
            except OSError:    # not every system lets everybody
                shutil.copyfile(here, there)


@contextlib.contextmanager
def sandbox(base: str) -> Iterator[Sandbox]:
    """Make one that stands for the file system as seen from the folder ``base``."""
    root = None
    with cleaned_up():
        try:
            with uninterrupted():    # what is there is known, and taken away whole
                root = Path(os.path.realpath(tempfile.mkdtemp(prefix="ppmcal-verify-")))
            yield Sandbox(root, base)
        finally:
            if root is not None:
                with uninterrupted():
                    shutil.rmtree(root, ignore_errors=True)
