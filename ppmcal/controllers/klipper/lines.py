"""The lines of a ``printer.cfg`` as Klipper reads them: its body, includes in place, and its block.

Klipper's reader (``configfile.py``) cuts the file at the exact header of ``SAVE_CONFIG``; what
stands above is the body, with included files where they are named, and its keys win over those of
the ``#*#`` block below. Where the header or a line after it has been changed it reads nothing of
the block.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ppmcal.controllers.text import read_text
from ppmcal.errors import BadInput

SAVED = "#*#"
BLOCK = ("#*# <---------------------- SAVE_CONFIG ---------------------->",
         "#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.", "#*#")
"""How the block of ``SAVE_CONFIG`` begins; Klipper wants these lines to the letter."""
MOST_FILES = 200
TEXT_WANTED = "Give the printer.cfg of a printer"
HEADER = re.compile(r"\[([^]]*)\]")
_INCLUDE = "include "


@dataclass(frozen=True)
class ConfigLine:
    """A line of text, its number from 1, and the file where it stands."""

    text: str
    number: int
    source: str


@dataclass
class ConfigLines:
    """A file's lines as they are read.

    Attributes:
        body: everything above the block, included files in place.
        block: lines of the block, without their ``#*# ``.
        files: included files that were followed.
        unknown: what is included and not followed.
    """

    body: list[ConfigLine] = field(default_factory=list)
    block: list[ConfigLine] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)


def split(text: str) -> list[str]:
    """Return the lines of a text as Klipper's reader has them, whatever system it is from."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def lines_of(text: str, source: str, path: Path | None = None) -> ConfigLines:
    """Return the lines of a ``printer.cfg``.

    Args:
        text: of the file.
        source: what messages call it.
        path: where it stands, to follow ``[include NAME]`` beside it and below; None follows none.

    Raises:
        BadInput: files include each other in a circle, or are too many or too large.
    """
    out = ConfigLines()
    every = [ConfigLine(t, n, source) for n, t in enumerate(split(text), 1)]
    out.block = [ConfigLine(line.text[4:], line.number, source) for line in every
                 if line.text.startswith(SAVED)]
    plain = [line for line in every if not line.text.startswith(SAVED)]
    out.body = list(_followed(plain, path, () if path is None else (path.resolve(),), out))
    return out


def _followed(lines: list[ConfigLine], path: Path | None, chain: tuple[Path, ...], out: ConfigLines
              ) -> Iterator[ConfigLine]:
    """Yield lines, those of an included file where it is named."""
    for line in lines:
        found = HEADER.match(line.text)
        name = "" if found is None else found[1].strip()
        if not name.startswith(_INCLUDE):
            yield line
            continue
        wanted = name.removeprefix(_INCLUDE).strip()
        beside = [] if path is None else _beside(path, wanted, chain[0].parent)
        if not beside and not (path is not None and glob.has_magic(wanted)):
            out.unknown.append(wanted)
        for file in beside:
            yield from _included(file, line, chain, out)
        yield ConfigLine("[]", line.number, line.source)     # what follows has to name its section


def _included(file: Path, line: ConfigLine, chain: tuple[Path, ...], out: ConfigLines
              ) -> Iterator[ConfigLine]:
    """Yield the lines of a file that ``line`` includes."""
    if file.resolve() in chain:
        raise BadInput(f"{file.name} includes itself", f"{line.source}: line {line.number}",
                       "Klipper refuses that: take the line out")
    if len(out.files) >= MOST_FILES:
        raise BadInput(f"more than {MOST_FILES} files are included",
                       f"{line.source}: line {line.number}",
                       "Put what describes the machine into one file")
    out.files.append(str(file))
    inner = [ConfigLine(t, n, str(file))
             for n, t in enumerate(split(read_text(file, TEXT_WANTED)), 1)]
    yield from _followed(inner, file, (*chain, file.resolve()), out)


def _beside(path: Path, wanted: str, top: Path) -> list[Path]:
    """Return the files that an include names, in Klipper's order; none outside the folder."""
    if Path(wanted).is_absolute() or ".." in Path(wanted).parts:
        return []
    names = sorted(glob.glob(wanted, root_dir=path.parent))
    found = [path.parent / name for name in names]
    return [f for f in found if f.is_file() and f.resolve().is_relative_to(top)]


def unread(text: str) -> str:
    """Return why Klipper reads nothing of the ``#*#`` lines of a file, empty where it does."""
    lines = split(text)
    if not any(line.startswith(SAVED) for line in lines):
        return ""
    start = next((i for i in range(1, len(lines)) if tuple(lines[i:i + 3]) == BLOCK), None)
    if start is None:
        return f"they do not begin with the lines `{BLOCK[0]}` and `DO NOT EDIT THIS BLOCK ...`"
    last = max(n for n, line in enumerate(lines) if line.strip())
    for n, line in enumerate(lines[:last + 1]):
        if n < start and line.startswith(f"{SAVED} "):
            return f"line {n + 1} stands above their header"
        if n > start and line[:4] not in (SAVED, f"{SAVED} "):
            return f"line {n + 1}, below their header, is none of them"
    return ""
