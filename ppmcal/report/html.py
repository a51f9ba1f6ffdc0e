"""Numbers as text, and tables as HTML: escaped cells, headers with their scope."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ppmcal.io.results.tables import finite_number
from ppmcal.plain import plain
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.web import spec, told

NBSP = "\u00a0"
_SUPER = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


number = finite_number


def sig(value: Any, digits: int = 3) -> str:
    """Return a number with some significant digits: ``0.0123``, ``1.2·10⁻⁷``, ``–`` for none."""
    x = number(value)
    if x is None:
        return "–"
    if x == 0.0:
        return "0"
    power = math.floor(math.log10(abs(float(f"{x:.{digits - 1}e}"))))
    if -5 <= power < 7:
        return f"{x:.{max(digits - 1 - power, 0)}f}".replace("-", "−")
    mantissa, exponent = f"{x:.{digits - 1}e}".split("e")
    return f"{mantissa.replace('-', '−')}·10{str(int(exponent)).translate(_SUPER)}"


def to_sigma(value: Any, sigma: Any) -> str:
    """Return a number with as many decimals as its sigma has at two digits."""
    x, s = number(value), number(sigma)
    if x is None or s is None or not s > 0.0:
        return sig(x, 5)
    decimals = 1 - math.floor(math.log10(s))
    if decimals > 9:
        return sig(x, 6)
    text = f"{x:.{max(decimals, 0)}f}".replace("-", "−")
    return text.removeprefix("−") if not text.strip("−0.") else text


def exact(value: Any, digits: int = 10) -> str:
    """Return a given number as it was given, to so many digits."""
    x = number(value)
    return "–" if x is None else f"{x:.{digits}g}".replace("-", "−")


def with_unit(value: Any, unit: str, digits: int = 3) -> str:
    """Return ``0.0123 mm``."""
    text = sig(value, digits)
    return f"{text}{NBSP}{unit}" if unit and text != "–" else text


def with_label(name: str, unit: str) -> str:
    """Return ``x (mm)``."""
    return f"{name} ({unit})" if unit else name


def probability(p: Any) -> str:
    """Return ``p = 0.4`` or ``p < 0.001``."""
    x = number(p)
    if x is None:
        return ""
    if x < 1e-3:
        power = math.floor(math.log10(x)) + 1 if x > 0.0 else -300
        return f"p{NBSP}<{NBSP}0.001" if power >= -3 else (
            f"p{NBSP}<{NBSP}10{str(max(power, -300)).translate(_SUPER)}")
    return f"p{NBSP}={NBSP}{min(x, 1.0):.2g}"


def count(n: int, one: str, many: str = "") -> str:
    """Return ``1 row`` or ``12 rows``."""
    return f"{whole(n)} {one if n == 1 else many or one + 's'}"


def whole(n: int) -> str:
    """Return a whole number with thin spaces between its thousands."""
    return f"{n:,}".replace(",", "\u2009")


def typeset(text: str) -> str:
    """Return a sentence of the console as the page writes it: ±, ×, −, χ², powers of ten."""
    text = re.sub(r"(\d)e([-+]\d+)", lambda m: f"{m[1]}·10{str(int(m[2])).translate(_SUPER)}", text)
    text = re.sub(r"(\d)\*", r"\1 × ", text)
    text = re.sub(r"(^| )-(?= |\d)", r"\1−", text)
    return text.replace("+- ", "± ").replace("chi-squared", "χ²")


MAX_ROWS = 200
"""Tables with one line for each data row stop here; the CSV holds them all."""


@dataclass(frozen=True)
class Cell:
    """One cell: ready HTML, its value for sorting, and its class (``n``: a number)."""

    html: str
    value: float | None = None
    kind: str = ""


def text_cell(text: object, kind: str = "") -> Cell:
    """Return a cell of plain text."""
    return Cell(escape("" if text is None else str(text)), None, kind)


def name_cell(name: object) -> Cell:
    """Return a cell with a name that may break after its dots."""
    return Cell(escape("" if name is None else str(name)).replace(".", ".<wbr>"))


def number_cell(value: Any, text: str | None = None, bad: bool = False) -> Cell:
    """Return a cell with a number, shown as ``text`` or with three digits."""
    return Cell(escape(sig(value) if text is None else text), number(value),
                "n bad" if bad else "n")


def csv_cell(text: str) -> Cell:
    """Return a cell of a CSV as it stands there, shortened if it is a number."""
    try:
        value = number(float(text))
    except ValueError:
        return text_cell(text)
    return number_cell(value, exact(value) if len(text) < 8 else sig(value, 6))


def table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[Cell]],
          sort: bool = False, keys: Sequence[str] = ()) -> str:
    """Return a table; the first cell of each row is its header.

    ``heads`` are plain text; ``keys``: of the measured row that each line is about.
    """
    if not rows:
        return ""
    numeric = [all("n" in r[i].kind.split() for r in rows) for i in range(len(heads))]
    return part("table", caption, heads, rows, numeric, sort and len(rows) > 2, keys)


def definitions(pairs: Sequence[tuple[str, str]], code: str = "") -> str:
    """Return a list of names and plain text; the one called ``code`` is shown as code."""
    told = [(k, v) for k, v in pairs if v]
    return part("definitions", told, code) if told else ""


def bullets(lines: Sequence[str]) -> str:
    """Return a list of plain lines."""
    return part("bullets", lines) if lines else ""


def paragraph(text: str, kind: str = "") -> str:
    """Return one paragraph of plain text, nothing for none."""
    return part("paragraph", text, kind) if text else ""


def figures(pictures: Sequence[Drawing | None], kind: str = "plots") -> str:
    """Return pictures with their captions, nothing for none; plots.js draws them in the page."""
    some = [p for p in pictures if p is not None]
    specs = [(p, found["height"], script_json(found)) for p in some for found in [spec(p)]]
    rows = {key: text for p in some for key, text in told(p).items()}
    return part("drawings", specs, kind, script_json(rows) if rows else "") if specs else ""


def script_json(content: object) -> str:
    r"""Return JSON that may stand in a script element, whatever its texts are.

    >>> script_json({"name": "</script>"})
    '{"name":"\\u003c/script\\u003e"}'
    """
    text = json.dumps(plain(content), separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def plot_scripts(sections: Sequence[str]) -> Markup:
    """Return the scripts that draw plots and machines, nothing where no section has any."""
    if not any('class="plot"' in s for s in sections):
        return Markup("")
    library, script = template_text("vendor/plotly.min.js"), template_text("plots.js")
    return Markup(f"<script>{library}</script><script>{script}</script>")


def error_bar(error: float | None, tolerance: float | None, half: float | None) -> str:
    """Return a small bar: the error against its tolerance, with the 95 % interval.

    The shaded zone is one tolerance to each side of nominal, the ends are three.
    """
    if error is None or tolerance is None or not tolerance > 0.0:
        return ""
    half = half or 0.0

    def at(value: float) -> float:
        return 65.0 + 20.0 * max(-2.9, min(2.9, value / tolerance))

    return part("error_bar", f"error {sig(error)}, tolerance {sig(tolerance)}", at(error - half),
                at(error + half), at(error), abs(error) > 3.0 * tolerance, 1 if error > 0 else -1)


@cache
def _environment() -> Environment:
    """Return the templates; text is escaped unless it is ready HTML."""
    made = Environment(loader=PackageLoader("ppmcal.report"), autoescape=True,
                       keep_trailing_newline=True, undefined=StrictUndefined)
    made.filters["sentence"] = _sentence
    return made


def _sentence(text: object) -> Markup:
    """Return plain text as HTML, with what stands in backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(Markup.escape(str(text)))))


def part(name: str, *values: Any) -> str:
    """Return one part of a page: a macro of parts.html."""
    return str(getattr(_environment().get_template("parts.html").module, name)(*values))


def whole_page(template: str, **values: Any) -> str:
    """Return a page of another template; text among ``values`` is escaped unless ``Markup``."""
    return _environment().get_template(template).render(**values)


def template_macro(template: str, name: str, *values: Any) -> str:
    """Return a macro of a template; text among ``values`` is escaped unless it is marked safe."""
    return str(getattr(_environment().get_template(template).module, name)(*values))


def template_text(name: str) -> str:
    """Return the text of a file among the templates."""
    return (files("ppmcal.report") / "templates" / name).read_text("utf-8")
