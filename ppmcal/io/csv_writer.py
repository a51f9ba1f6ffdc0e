"""CSV tables that are written: made line by line, so that a long one is never held whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ppmcal.store.output import LongText
from ppmcal.wording.progress import note

CHUNK = 20_000


def csv_text(header: Sequence[str], columns: Sequence[Any]) -> str:
    """Return a CSV, as :func:`csv_lines`, whole."""
    return str(csv_lines(header, columns))


def csv_lines(header: Sequence[str], columns: Sequence[Any],
              over: Sequence[float | None] | None = None) -> LongText:
    """Return a CSV with 17 significant digits.

    ``columns``: sequences or arrays (N,) of floats, integers, booleans or words (None is an empty
    cell); ``over``: what a column's numbers are divided by as they are written, None: nothing.
    """
    units = over or [None] * len(columns)
    arrays = [_printable(c if unit is None else np.asarray(c, dtype=float))
              for c, unit in zip(columns, units, strict=True)]
    if len(arrays) != len(header):
        raise ValueError(f"{len(header)} names for {len(arrays)} columns")
    sizes = {len(a) for _, a in arrays}
    if len(sizes) > 1:
        raise ValueError(f"columns of different lengths: {sorted(sizes)}")
    size = sizes.pop() if sizes else 0
    line = ",".join(form for form, _ in arrays) + "\n"
    plain = bool(arrays) and all(form == "%.17g" for form, _ in arrays)

    def parts() -> Iterator[str]:
        yield ",".join(_cell(h) for h in header) + "\n"
        for start in range(0, size, CHUNK):
            if start:
                note(f"row {start} of {size}")
            own = [a[start:start + CHUNK] if unit is None else a[start:start + CHUNK] / unit
                   for (_, a), unit in zip(arrays, units, strict=True)]
            if plain:
                cells = np.column_stack(own).ravel().tolist()
            else:
                lists = [a.tolist() if form != "%s" else [_cell(v) for v in a]
                         for (form, _), a in zip(arrays, own, strict=True)]
                cells = [c for row in zip(*lists, strict=True) for c in row]
            yield (line * len(own[0])) % tuple(cells)

    return LongText(parts)


def _printable(values: Any) -> tuple[str, Any]:
    """Return the format of a column and the column as an array (N,)."""
    array = np.asarray(values)
    if array.ndim != 1:
        array = np.array(list(values), dtype=object)
    if array.dtype.kind == "f":
        return "%.17g", array
    if array.dtype.kind in "iu":
        return "%d", array
    return "%s", array if array.dtype == object else array.astype(object)


def _cell(value: object) -> str:
    """Return one cell of text, quoted where it must be."""
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.17g}"
    text = str(value)
    if any(c in text for c in ',"\n\r'):
        return '"' + text.replace('"', '""') + '"'
    return text
