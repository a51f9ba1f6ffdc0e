"""What ``ppmcal read`` says of a file that it has understood; lines of at most 80 characters."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence

from ppmcal.io.column_names import reason_ignored
from ppmcal.io.foreign import HEADING, ForeignTable
from ppmcal.io.header import NAMED, bare_name

WIDTH = 80
Told = Callable[[ForeignTable, str], tuple[str, str]]
"""Unit of a column and from where it is known, both empty where it has none."""


def understood(found: ForeignTable, told: Told) -> str:
    """Return what was made of a file: how it is written, each column, what is left alone."""
    table = found.table
    how = found.form or (str(table.dialect) if table.dialect else "")
    head = f"{table.source}: {len(table)} rows" + (f", {how}" if how else "")
    lines = [head, *_columns(found, told)]
    if found.clock is not None:
        lines += _filled(f"time: {found.clock.words}; the first is "
                         f"{found.clock.name(found.clock.first)}")
    if found.ignored:
        lines += _filled(f"Ignored: {', '.join(found.ignored)}.")
        why = {h: reason_ignored(bare_name(h)) or reason_ignored(h) for h in found.ignored}
        for reason in dict.fromkeys(filter(None, why.values())):
            names = ", ".join(h for h, w in why.items() if w == reason)
            lines += _filled(f"{names}: {reason}. If it is a standard deviation, name it "
                             "sigma_x ... under `read.columns` in the sidecar.")
    if found.remarks:
        lines += _filled("Comment lines (ignored): "
                         f"{' | '.join(r[:60] for r in found.remarks[:6])}"
                         + (" ..." if len(found.remarks) > 6 else ""))
    return "\n".join(lines)


def _filled(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ",
                         break_long_words=True, break_on_hyphens=False)


def _columns(found: ForeignTable, told: Told) -> list[str]:
    """Return a table: our column, the file's header, its unit and from where that is known."""
    rows: list[tuple[str, str, str]] = []
    for own in found.table.header:
        column, (unit, whence) = found.columns.get(own), told(found, own)
        header, origin = (own, NAMED) if column is None else (column.shown, column.origin)
        same = header == own or header == f"{own} [{unit}]"
        if same and origin == NAMED:
            seen = ""
        else:
            seen = f"from '{header}'" if header != "(none)" else ""
            if origin not in (NAMED, HEADING):
                seen += f" ({origin})"
        rows.append((own, f"{unit} ({whence})" if unit and whence else unit, seen.strip()))
    return _laid_out(_together(rows))


def _together(rows: Sequence[tuple[str, str, str]]) -> list[tuple[str, str, str]]:
    """Return the rows, with those that say the same of neighbours in one."""
    out: list[tuple[list[str], str, str]] = []
    for own, unit, seen in rows:
        if out and not seen and out[-1][1:] == (unit, seen):
            out[-1][0].append(own)
        else:
            out.append(([own], unit, seen))
    return [(", ".join(n) if len(n) < 4 else f"{n[0]} ... {n[-1]} ({len(n)})", u, s)
            for n, u, s in out]


def _laid_out(rows: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return the rows under each other."""
    first = min(max((len(r[0]) for r in rows), default=0), 30)
    second = min(max((len(r[1]) for r in rows), default=0), 30)
    lines = []
    for name, unit, seen in rows:
        text = f"  {name:<{first}}  {unit:<{second}}  {seen}".rstrip()
        lines += [text] if len(text) <= WIDTH else textwrap.wrap(
            " ".join(text.split()), WIDTH, initial_indent="  ", subsequent_indent="      ",
            break_on_hyphens=False)
    return lines
