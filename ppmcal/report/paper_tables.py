"""Tables for papers: parameters and errors of identifications, as LaTeX (booktabs) and Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ppmcal.io.results.identification_parts import ParameterEstimate
from ppmcal.report.format import exact, sig, to_sigma
from ppmcal.report.identification import COLUMNS, errors
from ppmcal.report.records import Identified

TEX = str.maketrans({
    "\\": r"\textbackslash{}", "_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "$": r"\$",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$",
    "±": r"$\pm$", "×": r"$\times$", "·": r"$\cdot$", "→": r"$\to$", "…": r"\dots{}",
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
    return " & ".join(map(tex, cells)) + r" \\"


def tables(one: Identified) -> Iterator[PaperTable]:
    """Yield the tables of an identification: its parameters, effects among them, and its errors."""
    free = [p for p in one.record.parameters if p.status != "fixed"]
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
    status = p.status + ", sessions disagree" * bool(p.disagree)
    if not shown:
        return p.name, exact(p.value), "–", sig(p.error), p.unit, status
    return (p.name, to_sigma(p.value, shown), to_sigma(shown, shown), to_sigma(p.error, shown),
            p.unit, status)


def rounded(half: float | None) -> float:
    """Return half an interval with two digits, 0 where there is none.

    >>> rounded(0.0996)
    0.1
    """
    return float(f"{half:.1e}") if half is not None and math.isfinite(half) else 0.0
