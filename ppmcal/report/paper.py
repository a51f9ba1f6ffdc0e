"""The figures of the page, and tables of its numbers, as files for papers with their captions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

from ppmcal.calibration.fit import secondary
from ppmcal.errors import BadInput, unknown
from ppmcal.io.results.identification_parts import ParameterEstimate
from ppmcal.notes import Note
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.paper import paper
from ppmcal.report.html import exact, sig, to_sigma
from ppmcal.report.identified import COLUMNS, errors
from ppmcal.report.kinds import IN_ORDER
from ppmcal.report.records import Identified, ReportData
from ppmcal.report.section import Drawn, free_name, slug
from ppmcal.store.folder import CAMPAIGNS

TEX = str.maketrans({
    "\\": r"\textbackslash{}", "_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "$": r"\$",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$",
    "±": r"$\pm$", "×": r"$\times$", "·": r"$\cdot$", "→": r"$\to$", "…": r"\dots{}",
    "<": "$<$", ">": "$>$", "|": "$|$",    # other letters in the usual fonts
    "°": r"$^\circ$", "µ": r"$\mu$", "μ": r"$\mu$", "χ": r"$\chi$", "σ": r"$\sigma$",
    "\u00a0": "~", "\u2009": r"\,", "⁻": r"$^{-}$", "○": r"$\circ$", "●": r"$\bullet$"}
    | {c: f"$^{n}$" for n, c in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")})
"""What stands for letters in LaTeX."""
MARKDOWN = str.maketrans({c: f"\\{c}" for c in "\\|*_`<"})


@dataclass(frozen=True)
class PaperTable:
    """A table: what it shows, heads, rows of words, and which columns hold numbers."""

    name: str
    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: frozenset[int]

    def tex(self) -> str:
        """Return it as LaTeX, to be read in a table; it needs the package booktabs."""
        columns = "".join("r" if i in self.numbers else "l" for i in range(len(self.heads)))
        lines = [r"\begin{tabular}{" + columns + "}", r"\toprule", _row(self.heads), r"\midrule",
                 *map(_row, self.rows), r"\bottomrule", r"\end{tabular}"]
        return "\n".join(lines) + "\n"

    def markdown(self) -> str:
        """Return it as Markdown."""
        rule = ["---:" if i in self.numbers else "---" for i in range(len(self.heads))]
        body = [[c.translate(MARKDOWN) for c in row] for row in self.rows]
        return "".join(f"| {' | '.join(row)} |\n" for row in (self.heads, rule, *body))


def tex(words: str) -> str:
    r"""Return words as LaTeX writes them.

    >>> print(tex("leg_1: 5·10⁻³"))
    leg\_1: 5$\cdot$10$^{-}$$^3$
    """
    return words.translate(TEX)


def _row(cells: Sequence[str]) -> str:
    row = " & ".join(map(tex, cells)) + r" \\"
    return f"{{}}{row}" if row.startswith(("[", "*")) else row    # or the \\ before it takes that


def tables(one: Identified) -> Iterator[PaperTable]:
    """Yield the tables of an identification: its parameters, effects among them, and its errors."""
    free = one.record.free
    if free:
        fixed = len(one.record.parameters) - len(free)
        more = f" {fixed} more were held fixed." if fixed else ""
        yield PaperTable(
            "parameters", "Identified parameters with the half width of their 95 % interval; "
            f"change: from nominal.{more}", ("parameter", "value", "± 95 %", "change", "unit",
                                             "status"),
            [_parameter(p) for p in free], frozenset({1, 2, 3}))
    found = list(errors(one))
    if found:
        yield PaperTable(
            "errors", "Errors before and after calibration, and held out: of poses kept out of "
            "the fit; p95: 95 % of the rows are below it.", ("error", *COLUMNS, "unit"),
            [(name, *(sig(getattr(part, c)) for c in COLUMNS), part.unit)
             for _, name, part in found], frozenset({1, 2, 3, 4}))


def _parameter(p: ParameterEstimate) -> tuple[str, ...]:
    """Return a parameter's row; all its numbers have the decimals of the interval's two digits."""
    shown = rounded(p.half)
    numbers = (exact(p.value), "–", sig(p.error)) if not shown else tuple(
        to_sigma(v, shown) for v in (p.value, shown, p.error))
    return p.name, *numbers, p.unit, p.status_words


def rounded(half: float | None) -> float:
    """Return half an interval with two digits, 0 where there is none.

    >>> rounded(0.0996)
    0.1
    """
    return float(f"{half:.1e}") if half is not None and math.isfinite(half) else 0.0


LONGEST = 60
"""Letters of a file's name."""


@dataclass(frozen=True)
class Sheet:
    """One figure or table.

    Attributes:
        name: of its file, without an ending.
        own: the name without the folder, which stands before it where there are several.
        group: the part of the page that it is from.
        content: what it shows.
    """

    name: str
    own: str
    group: str
    content: Drawing | PaperTable

    @property
    def caption(self) -> str:
        """What it shows and how to read it."""
        return self.content.caption if isinstance(self.content, PaperTable) else (
            f"{self.content.title.rstrip('.')}. {self.content.caption}".strip())

    def matches(self, pattern: str) -> bool:
        """Whether it is asked for: by its name, with or without the folder, or by its group."""
        return any(fnmatchcase(name, pattern) for name in (self.name, self.own, self.group))

    def files(self, width: float, form: str) -> dict[str, str | bytes]:
        """Return file name -> content; ``width``: of a figure, mm, ``form``: its format."""
        if isinstance(self.content, PaperTable):
            return {f"{self.name}.tex": self.content.tex(), f"{self.name}.md":
                    self.content.markdown()}
        return {f"{self.name}.{form}": paper(self.content, width, form)}


def sheets(data: ReportData, notes: list[Note], only: Sequence[str] = ()) -> list[Sheet]:
    """Return the figures and tables of a report, those that are asked for.

    ``notes``: to which is added what cannot be drawn; ``only``: patterns of names or groups.

    Raises:
        BadInput: there is none, or none of a name.
    """
    found = list(_all(data, notes))
    if not found:
        raise BadInput("hold no figure and no table", ", ".join(data.folders),
                       "Name output folders of identify, diagnose, compensate, kinematics, "
                       "validate, compare or export")
    for pattern in only:
        if not any(s.matches(pattern) for s in found):
            raise unknown("figure", pattern, dict.fromkeys([*(s.group for s in found),
                                                      *(s.name for s in found)]),
                          "--only")
    return [s for s in found if not only or any(s.matches(p) for p in only)]


def _all(data: ReportData, notes: list[Note]) -> Iterator[Sheet]:
    """Yield every figure and table."""
    taken, leads = set[str](), _leads(data.folders)

    def lead(folder: str) -> str:
        return leads.get(folder, f"{slug(Path(folder).name)}-") if len(leads) > 1 else ""

    for kind in IN_ORDER:
        for one in kind.of(data):
            folder = str(getattr(one, "folder", "") or getattr(one, "identified", ""))
            make: Callable[[], Drawn] = partial(kind.drawings, one, data)
            for group, drawings in secondary(f"figures of {folder}", make, {}, notes).items():
                for drawing in filter(None, drawings):
                    own = slug(drawing.title)[:LONGEST].rstrip("-")
                    yield Sheet(free_name(lead(folder) + own, taken), own, group, drawing)
    for fit in data.identified:
        for table in tables(fit):
            yield Sheet(free_name(lead(fit.folder) + table.name, taken), table.name, "tables",
                        table)


def _leads(folders: Sequence[str]) -> dict[str, str]:
    """Return by folder how the names of its files begin: as it is called.

    In a batch that is by machine, date and command. Those that are called alike have as many of
    the names above before theirs as tell them apart.

    >>> _leads(["a/x", "one/may/fit", "two/may/fit"])
    {'a/x': 'x-', 'one/may/fit': 'one-may-fit-', 'two/may/fit': 'two-may-fit-'}
    """
    parts = {folder: Path(folder).absolute().parts for folder in folders}
    depth = {folder: 3 if Path(*p[:-3], CAMPAIGNS).is_file() else 1 for folder, p in parts.items()}
    while True:
        names = {folder: slug("-".join(p[-depth[folder]:])) for folder, p in parts.items()}
        count = Counter(names.values())
        alike = [folder for folder, name in names.items()
                 if count[name] > 1 and depth[folder] < len(parts[folder])]
        if not alike:
            return {folder: f"{name}-" for folder, name in names.items()}
        for folder in alike:
            depth[folder] += 1


def captions(some: Sequence[Sheet]) -> dict[str, str]:
    """Return captions.md, and captions.tex with an environment for each figure and table."""
    lines = [f"**{s.name}**: {s.caption}\n" for s in some]
    return {"captions.md": "\n".join(lines), "captions.tex": "\n".join(map(_environment, some))}


def _environment(s: Sheet) -> str:
    """Return a figure or table of LaTeX."""
    kind, content = ("table", rf"\input{{{s.name}}}") if isinstance(s.content, PaperTable) else (
        "figure", rf"\includegraphics{{{s.name}}}")
    caption = rf"  \caption{{{tex(s.caption)}}}"
    label = rf"  \label{{{kind[:3]}:{s.name}}}"
    parts = [caption, label, f"  {content}"] if kind == "table" else [
        f"  {content}", caption, label]
    return "\n".join([rf"\begin{{{kind}}}", r"  \centering", *parts, rf"\end{{{kind}}}", ""])


def entries(some: Sequence[Sheet]) -> list[dict[str, Any]]:
    """Return name, group and caption of each, as JSON has them."""
    return [{"name": s.name, "group": s.group, "caption": s.caption,
             "kind": "table" if isinstance(s.content, PaperTable) else "figure"} for s in some]
