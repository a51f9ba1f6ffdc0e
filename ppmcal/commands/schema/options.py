"""What ``ppmcal schema`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, argument


@dataclass(frozen=True)
class SchemaArguments(Arguments):
    """Which file."""

    name: str = argument("FILE", "Of the file.",
                         complete="ppmcal.commands.schema.run:known")


COMMAND = Command(
    "schema", SchemaArguments,
    about=("Print the JSON Schema of a file, for editors that complete and check it.",
           "{name} is mechanism, dataset (the YAML beside a CSV), scenario or batch (a manifest), "
           "or a result: identification, diagnosis, comparison, ... Kinds of limbs and effects "
           "that other packages add are in it."),
    examples=("ppmcal schema mechanism",), result="dict[str, Any]", data=True, recorded=False,
    raises="BadInput: there is no such file; the text lists them.")
