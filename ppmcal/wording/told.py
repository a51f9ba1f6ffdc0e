"""What a result says of itself, for whoever shows it: sentences, short tables, findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

WIDTH = 80
"""Columns that a line of text may have."""


@dataclass(frozen=True)
class ShortTable:
    """Rows of text below ``heads``; the columns ``right`` are numbers."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    right: Sequence[int] = ()


@dataclass(frozen=True)
class Findings:
    """Sentences that need a look, where they do not stand at the end."""

    sentences: Sequence[str]


@dataclass(frozen=True)
class CommandLine:
    """A command to be copied, behind what it is for."""

    head: str
    words: Sequence[object]


@dataclass(frozen=True)
class CopiedLines:
    """Lines to be copied into a file: shown as they are, however long."""

    lines: Sequence[str]


Told = str | ShortTable | Findings | CommandLine | CopiedLines
"""A part of what a result says."""
