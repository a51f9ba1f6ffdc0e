"""JSON Schemas of the files that are read and written."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ppmcal import codec, commands
from ppmcal.commands.batch.manifest import manifest_schema
from ppmcal.commands.certify.about import about_schema
from ppmcal.commands.schema.options import SchemaArguments
from ppmcal.errors import unknown
from ppmcal.io import json_schema
from ppmcal.io.json_schema import DIALECT
from ppmcal.io.results.record import Record

OWN = {"batch": manifest_schema, "about": about_schema}
FILES = (*json_schema.FILES, *OWN)
"""Files that a user writes."""


def results() -> dict[str, str]:
    """Return name -> ``module:class`` of the records that commands write."""
    made = (commands.command(name).record for name in commands.names())
    return dict(one for one in made if one)


def known() -> list[str]:
    """Return the names of all files that have a schema."""
    return [*FILES, *results()]


def file_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of a file that a user writes.

    Raises:
        BadInput: there is no such file.
    """
    return OWN[name]() if name in OWN else json_schema.file_schema(name)


def run(asked: SchemaArguments) -> dict[str, Any]:
    """Return the JSON Schema of a file."""
    name = asked.name
    if name in FILES:
        return file_schema(name)
    if name not in (records := results()):
        raise unknown("file", name, known())
    module, _, found = records[name].partition(":")
    record: type[Record] = getattr(import_module(module), found)
    return {"$schema": DIALECT, **codec.schema(record)}
