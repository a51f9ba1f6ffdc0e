"""What every import has in common: files of a machine and its measurements, and what is said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

MACHINE = "machine.yaml"
"""The machine as it was meant to be, or as it is roughly known."""


class Imported(Protocol):
    """What a controller's files say of a machine."""

    @property
    def findings(self) -> Sequence[str]:
        """What the user must look at."""
        ...

    @property
    def inputs(self) -> Sequence[str]:
        """Other files that were read."""
        ...

    def files(self) -> Mapping[str, str]:
        """Return file name -> text: :data:`MACHINE`, tables of measurements and their sidecars."""
        ...

    def headline(self) -> str:
        """Return what the files hold, in a sentence."""
        ...

    def summary(self) -> Mapping[str, object]:
        """Return what ``--json`` prints of it."""
        ...


@dataclass(frozen=True)
class ImportedFiles:
    """The same, where all of it is known at once: :class:`Imported`."""

    texts: Mapping[str, str]
    sentence: str
    entries: Mapping[str, object]
    findings: tuple[str, ...] = ()
    inputs: tuple[str, ...] = field(default=())

    def files(self) -> Mapping[str, str]:
        """Return file name -> text."""
        return self.texts

    def headline(self) -> str:
        """Return what the files hold."""
        return self.sentence

    def summary(self) -> Mapping[str, object]:
        """Return what ``--json`` prints of it."""
        return self.entries


class Importer(Protocol):
    """A module, or an object, that reads the files of one controller."""

    def import_config(self, path: Path, options: Mapping[str, Any]) -> Imported:
        """Return the machine and its measurements.

        Args:
            path: the controller's file.
            options: the values of the options that its ``CONTROLLER`` names, by their names.

        Raises:
            BadInput: anything wrong in the files or options.
        """
        ...
