"""What the console says of an export: the numbers, and what they are worth."""

from __future__ import annotations

from collections.abc import Iterator

from ppmcal.io.results.export import ExportRecord, error_size, fixed
from ppmcal.wording.told import ShortTable, Told

ROWS = 24
"""Numbers that are shown."""


def told(record: ExportRecord) -> Iterator[Told]:
    """Yield the numbers, the errors with old and new ones, notes and advice."""
    yield f"{record.name}: {record.summary}."
    if record.parameters:
        yield ShortTable(["parameter", "old", "new", "change", "unit"],
                         list(_numbers(record))[:ROWS], (1, 2, 3))
    if len(record.parameters) > ROWS:
        yield f"... and {len(record.parameters) - ROWS} more, all in export.json."
    yield (f"Predicted error over {record.over}; \"expected\" counts the model's own uncertainty "
           "too:")
    yield _errors(record)
    yield record.predicted.sentence()
    for note in record.notes:
        yield f"Note: {note}."
    yield from record.advice


def _errors(record: ExportRecord) -> ShortTable:
    """Return the table of errors with the old and the new numbers."""
    rows = [[label, *(error_size(v, part.unit) or "unknown" for part in (e, e.rotation)
                      if part is not None for v in (part.rms, part.max))]
            for label, e in (("old, model exact", record.before),
                             ("new, model exact", record.after))]
    for label, size in (("old, expected", record.predicted.before),
                        ("new, expected", record.predicted.after)):
        expected = [error_size(size.rms, size.unit) or "unknown", ""]
        if record.after.rotation is not None:
            turn = size.rotation
            expected += [error_size(turn.rms, turn.unit) if turn else "unknown", ""]
        rows.append([label, *expected])
    turns = ["rms deg", "max deg"] * (record.after.rotation is not None)
    return ShortTable(["", "rms mm", "max mm", *turns], rows, (1, 2, 3, 4))


def _numbers(record: ExportRecord) -> Iterator[list[str]]:
    """Yield the rows of the table of numbers."""
    for name, new in record.parameters.items():
        old = record.old.get(name)
        if name.endswith(" points"):    # a count, not a length
            yield [name, "-", f"{new:.0f}", "-", ""]
            continue
        change = "-" if old is None or new is None else f"{round(new - old, 4) + 0.0:+.4f}"
        yield [name, fixed(old) or "-", fixed(new), change, record.number_units.get(name, "")]
