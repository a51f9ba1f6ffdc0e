"""A controller's files as a machine and its measurements."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.commands.import_.options import ImportArguments
from ppmcal.commands.result import Result
from ppmcal.controllers import IMPORTS, loaded, own
from ppmcal.controllers.importing import MACHINE, Imported, Importer
from ppmcal.errors import BadInput
from ppmcal.store.provenance import source_of
from ppmcal.wording.told import CommandLine, Told

ROBOTS = {
    "urdf": "it describes trees, and a parallel machine is a loop",
    "sdf": "its loops are joints between links, which say nothing of limbs, drives or home"}
"""Models of robots that are neither written, and why they are not a mechanism."""


@dataclass(frozen=True, eq=False, repr=False)
class ImportResult(Result):
    """A machine and its measurements, as a controller's files say them.

    Attributes:
        imported: what the controller's importer made of them.
    """

    COMMAND: ClassVar[str] = "import"
    TABLE: ClassVar[str] = "heights.csv"

    imported: Imported

    def files(self) -> Mapping[str, str | bytes]:
        """Return machine.yaml, and tables of measurements with sidecars."""
        return dict(self.imported.files)

    def headline(self) -> str:
        """Return what the files hold."""
        return self.imported.headline

    def finished(self, written: Sequence[Path], asked: Any) -> Iterator[Told]:
        """Yield where the files are, and what to do with the measurements among them."""
        yield from super().finished(written, asked)
        if tables := [p for p in written if p.suffix == ".csv"]:
            machine = written[0].with_name(MACHINE)
            yield CommandLine("Next:", ["ppmcal", "identify", machine, *tables])

    def summary_of(self, written: Sequence[Path]) -> Mapping[str, Any]:
        """Return the names of the files that were written."""
        return {"written": [p.name for p in written]}

    def summary(self) -> dict[str, object]:
        """Return what the command prints as JSON, but for the files written."""
        return {"format": "ppmcal/import/1", **self.imported.entries,
                "findings": list(self.findings), "provenance": self.provenance}


def run(asked: ImportArguments) -> ImportResult:
    """Turn a controller's files into a machine and its measurements."""
    form, file = asked.form, asked.file
    models = ROBOTS | {name: one.unread for name, one in own().items() if one.unread}
    if form.lower() in models:
        raise BadInput(f"{form.upper()} is not imported: {models[form.lower()]}", str(file),
                       "Begin with `ppmcal init 6-UPS` or the kind of your machine, and copy the "
                       "joints' places at home from the file; docs/notes.md says why")
    reader: Importer = loaded(form, IMPORTS)
    found = reader.import_config(Path(file), asked.options())
    return ImportResult(source_of("import_config", [file, *found.inputs], None),
                        tuple(found.findings), found)
