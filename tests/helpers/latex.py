"""LaTeX as its engine reads it, so far as tables and captions go: what it would stop at or misread.

No engine is needed, and nothing of the program is: catcodes of plain text, environments, cells.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

PLAIN = {r"\textbackslash", r"\textasciitilde", r"\textasciicircum", r"\dots", r"\,",
         r"\toprule", r"\midrule", r"\bottomrule", r"\centering", r"\caption", r"\label",
         r"\input", r"\includegraphics", r"\begin", r"\end", *(rf"\{c}" for c in "_%&#${}")}
"""Commands of the kernel, graphicx and booktabs that may stand in text."""
MATHS = {r"\pm", r"\times", r"\cdot", r"\to", r"\circ", r"\mu", r"\chi", r"\sigma"}
NAMES = (r"\label", r"\input", r"\includegraphics")
"""Whose argument is a name, as it stands."""
KERNEL = re.compile(r"[\x20-\x7e\n\u00c0-\u00d6\u00d8-\u00f6\u00f8-\u00ff–—‘’“”]")
"""Letters that LaTeX knows without a package: ASCII, accents, dashes and quotes."""
TOKEN = re.compile(r"\\\\|\\(?:begin|end)\{(?P<environment>[a-z]+\*?)\}|\\[A-Za-z]+|\\.|.|\n",
                   re.DOTALL)


@dataclass
class Reader:
    """What a text is wrong in, and how it stands: open environments, braces, mathematics."""

    faults: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    columns: int = 0
    cells: int = 1
    rows: int = 0
    empty: bool = True
    maths: bool = False
    ended: bool = False

    def fault(self, what: str, line: int) -> None:
        self.faults.append(f"line {line}: {what}")

    def close(self, what: str, line: int) -> None:
        if not self.open or self.open.pop() != what:
            self.fault(f"{what} is closed, but not open last", line)

    def row(self, line: int) -> None:
        if self.open[-1:] != ["tabular"]:
            self.fault(r"\\ outside of a table, or within braces", line)
        elif self.cells != self.columns:
            self.fault(f"{self.cells} cells in {self.columns} columns", line)
        if self.maths:
            self.fault("mathematics goes on behind a cell", line)
        self.cells, self.rows, self.empty = 1, self.rows + 1, True


def faults(text: str) -> list[str]:
    """Return what an engine would stop at or misread in a text, each with its line."""
    at, found = 0, Reader()
    while at < len(text):
        token = TOKEN.match(text, at)
        assert token is not None
        word, line = token[0], text.count("\n", 0, at) + 1
        at = token.end()
        if token["environment"]:
            at = _environment(found, token, text, line)
        elif word in NAMES:
            name = re.compile(r"\{([A-Za-z0-9:./-]+)\}").match(text, at)
            at = name.end() if name else at
            if not name:
                found.fault(f"{word} of no plain name", line)
        else:
            _token(found, word, line)
    for left in reversed(found.open):
        found.fault(f"{left} is open at the end", text.count("\n") + 1)
    if found.maths:
        found.fault("mathematics is open at the end", text.count("\n") + 1)
    return found.faults


def _environment(found: Reader, token: re.Match[str], text: str, line: int) -> int:
    """Open or close an environment; return where the text goes on."""
    name = token["environment"]
    if token[0].startswith(r"\end"):
        if name == "tabular" and not found.empty:
            found.fault(r"a last row without \\", line)
        found.close(name, line)
        return token.end()
    found.open.append(name)
    if name != "tabular":
        return token.end()
    columns = re.compile(r"\{([lcr]+)\}").match(text, token.end())
    if not columns:
        found.fault("a table of no columns", line)
        return token.end()
    found.columns, found.cells, found.empty = len(columns[1]), 1, True
    return columns.end()


def _token(found: Reader, word: str, line: int) -> None:
    """Read a command or a letter."""
    if word == "\\\\":
        found.row(line)
        found.ended = True
        return
    if found.ended and word in "[*":
        found.fault(f"{word} is taken by the \\\\ before it", line)
    found.ended &= word.isspace()
    if word in "<>|" and not found.maths:
        found.fault(f"{word} is another letter in the usual fonts", line)
    if word == "$":
        found.maths, found.empty = not found.maths, False
    elif word == "{":
        found.open.append("{")
    elif word == "}":
        found.close("{", line)
    elif word == "&":
        if found.open[-1:] != ["tabular"] or found.maths:
            found.fault("& outside of a table's cells", line)
        found.cells += 1
    elif word in "_^":
        if not found.maths:
            found.fault(f"{word} outside of mathematics", line)
    elif word in "%#":
        found.fault(f"{word} as it stands", line)
    elif word.startswith("\\"):
        if word not in (MATHS if found.maths else PLAIN):
            found.fault(f"{word} in {'mathematics' if found.maths else 'text'}", line)
        found.empty &= word in (r"\toprule", r"\midrule", r"\bottomrule")
    elif not KERNEL.fullmatch(word):
        found.fault(f"{word!r}, which needs a package", line)
    elif not word.isspace():
        found.empty = False
