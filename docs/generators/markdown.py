"""Pieces of Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def cell(text: object) -> str:
    """Return text that may stand in a table's cell."""
    parts = str(text).replace("\n", " ").strip().split("`")
    # bars in code are no borders
    return "`".join(p if i % 2 else p.replace("|", "\\|") for i, p in enumerate(parts))


def code(text: object) -> str:
    """Return inline code, also of text that holds bars or backticks; nothing for nothing."""
    return f"`{text}`" if str(text) else ""


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table; columns that are empty in every row are left out."""
    rows = [[cell(c) for c in row] for row in rows]
    kept = [i for i in range(len(headings)) if i == 0 or any(row[i] for row in rows)]
    lines = [[headings[i] for i in kept], ["---"] * len(kept),
             *([row[i] for i in kept] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def anchor(heading: str) -> str:
    """Return the anchor that the site gives to a heading of its own kind (letters and digits)."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())


def fenced(text: str, language: str = "yaml") -> str:
    """Return a block of code."""
    return f"```{language}\n{text.strip()}\n```\n"


def plain(text: str) -> str:
    """Return a sentence of the program as Markdown: its symbols are no markup."""
    return re.sub(r"([*_<\[\]])", r"\\\1", text)
