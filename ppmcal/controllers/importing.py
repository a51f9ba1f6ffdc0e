"""What every import has in common: files of a machine and its measurements, and what is said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import yaml

from ppmcal.io.yaml import printable

MACHINE = "machine.yaml"
"""The machine as it was meant to be, or as it is roughly known."""


def machine_head(name: str, motion: str) -> str:
    """Return how a mechanism file in mm and degrees begins, below its comment."""
    shown = yaml.safe_dump(printable(name), width=1000).strip().removesuffix("...").strip()
    return f"""\
format: ppmcal/mechanism/1
name: {shown}
units: {{length: mm, angle: deg}}   # of every number in this file
motion: {motion}
"""


def sidecar(comment: str, name: str, kind: str, sigma: Mapping[str, float], begins: float,
            rest: str) -> str:
    """Return the sidecar of a table whose noise is estimated, which ``begins`` with so many mm."""
    stated = ", ".join(f"{k}: {v:g}" for k, v in sigma.items())
    return f"""\
{comment}
# sigma: how far one reading scatters, estimated from what is left; {begins:g} mm begins it.
# Where you know it, put it in and take `estimated` out.
format: ppmcal/dataset/1
name: {name}
units: {{length: mm, angle: deg}}
instrument: {{kind: {kind}, sigma: {{{stated}, estimated: true}}}}
{rest}"""


@dataclass(frozen=True)
class Imported:
    """What a controller's files say of a machine.

    Attributes:
        files: name -> text: :data:`MACHINE`, tables of measurements and their sidecars.
        headline: what the files hold.
        entries: what ``--json`` prints of it.
        findings: what the user must look at.
        inputs: other files that were read.
    """

    files: Mapping[str, str]
    headline: str
    entries: Mapping[str, object]
    findings: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()


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
