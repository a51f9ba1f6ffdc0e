"""Every result that is written has a schema by its name, and a format of its own."""

from __future__ import annotations

import pkgutil
from importlib import import_module

import ppmcal.io.results as results
from ppmcal import schema
from ppmcal.commands.schema.run import results as records
from ppmcal.io.results.record import Record


def written() -> dict[str, list[str]]:
    """Return format -> names of the records that say so."""
    out: dict[str, list[str]] = {}
    for module in pkgutil.iter_modules(results.__path__):
        for name, kind in vars(import_module(f"{results.__name__}.{module.name}")).items():
            if isinstance(kind, type) and issubclass(kind, Record) and kind.__dict__.get("FORMAT"):
                out.setdefault(kind.FORMAT, []).append(f"{module.name}.{name}")
    return {f: sorted(set(names)) for f, names in out.items()}


def test_every_format_has_a_schema():
    known = {path.removeprefix(f"{results.__name__}.").replace(":", ".")
             for path in records().values()}
    own = {f: [n for n in names if n in known] for f, names in written().items()}
    assert not [f for f, names in own.items() if len(names) != 1]
    for name in records():
        assert schema(name)["properties"]["format"]
