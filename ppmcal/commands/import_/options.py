"""What ``ppmcal import`` takes: a format, a file, and what each controller asks for besides."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from ppmcal.commands.spec import Arguments, Command, Path_, argument, flags, option, taken
from ppmcal.controllers import (
    IMPORTS,
    about,
    examples,
    import_options,
    imported,
    options_of,
    own,
)
from ppmcal.errors import BadInput
from ppmcal.wording import abbreviate_list


def _names() -> str:
    known = own()
    return ", or ".join(f"{name}: {known[name].title}" if name in known and known[name].title
                        else name for name in imported()) + "."


def _about() -> str:
    formats = " ".join(f"{{form}} {one}" for one in about(IMPORTS))
    return (f"{formats} Writes machine.yaml (the machine as it was meant to be) and its "
            "measurements as .csv and .yaml; of a delta printer also saved.yaml (as a calibration "
            "left it): heights, distances and mesh_NAME where there are any.")


@dataclass(frozen=True)
class ImportArguments(Arguments):
    """The controller's file; what it is asked for besides are fields of the class below."""

    form: str = argument("FORMAT", _names, complete="ppmcal.controllers:imported")
    file: Path_ = argument("FILE", "The controller's file.")

    def options(self) -> dict[str, Any]:
        """Return the values of the format's own options by name.

        Raises:
            BadInput: another format's option was given, or there is no such format.
        """
        known = [one.name for one in options_of(self.form)]
        given = {one.name: (getattr(self, one.name), one) for one in taken(OPTIONS)
                 if not one.option.argument}
        for name, (value, one) in given.items():
            if name not in known and value != one.value:
                raise BadInput(f"{self.form} has no option {flags(one)[0]}", flags(one)[0],
                               "Leave it out" + (f"; it has {abbreviate_list(_flags(known))}"
                                                 if known else ""))
        return {name: given[name][0] for name in known}

    def unused(self) -> Collection[str]:
        """Return the options of other formats."""
        if self.form.lower() not in imported():
            return ()
        return set(import_options()) - {one.name for one in options_of(self.form)}


OPTIONS: type[ImportArguments] = dataclasses.make_dataclass(
    "ImportArguments", [
        (one.name, one.kind, option(one.default, one.help, **one.how))
        for one in import_options().values()], bases=(ImportArguments,), frozen=True)
"""The arguments with the options of all formats."""


def _flags(names: Collection[str]) -> list[str]:
    return [flags(one)[0] for one in taken(OPTIONS) if one.name in names]


COMMAND = Command(
    "import", OPTIONS,
    about=("Turn a controller's file {file} into a machine and its measurements.", _about),
    examples=examples("import"), out="imported", result="ImportResult",
    python="import_config", raises="BadInput: another format, or anything wrong in the files.")
