"""Tables as HTML: escaped cells, row and column headers with their scope."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from ppmcal.report.format import exact, number, sig

MAX_ROWS = 200
"""Tables with one line for each data row stop here; the CSV holds them all."""


@dataclass(frozen=True)
class Cell:
    """One cell: ready HTML, its value for sorting, and its class (``n``: a number)."""

    html: str
    value: float | None = None
    kind: str = ""


def words(text: object, kind: str = "") -> Cell:
    """Return a cell of plain text."""
    return Cell(escape("" if text is None else str(text)), None, kind)


def dotted(name: object) -> Cell:
    """Return a cell with a name that may break after its dots."""
    return Cell(escape("" if name is None else str(name)).replace(".", ".<wbr>"))


def amount(value: Any, text: str | None = None, bad: bool = False) -> Cell:
    """Return a cell with a number, shown as ``text`` or with three digits."""
    return Cell(escape(sig(value) if text is None else text), number(value),
                "n bad" if bad else "n")


def given(text: str) -> Cell:
    """Return a cell of a CSV as it stands there, shortened if it is a number."""
    try:
        value = number(float(text))
    except ValueError:
        return words(text)
    return amount(value, exact(value) if len(text) < 8 else sig(value, 6))


def table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[Cell]],
          sort: bool = False) -> str:
    """Return a table; the first cell of each row is its header. ``heads`` are plain text."""
    if not rows:
        return ""
    numeric = [all("n" in r[i].kind.split() for r in rows) for i in range(len(heads))]
    top = "".join(f'<th scope="col"{_class("n" if n else "")}>{escape(h)}</th>'
                  for h, n in zip(heads, numeric, strict=True))
    body = "".join("<tr>" + "".join(_cell(c, i == 0) for i, c in enumerate(r)) + "</tr>"
                   for r in rows)
    name = escape(caption or "table")
    return (f'<div class="scroll" role="region" tabindex="0" aria-label="{name}">'
            f'<table{_class("sort" if sort and len(rows) > 2 else "")}>'
            + (f"<caption>{name}</caption>" if caption else "")
            + f"<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>")


def _cell(cell: Cell, first: bool) -> str:
    value = "" if cell.value is None else f' data-v="{cell.value:.7g}"'
    if first:
        return f'<th scope="row"{_class(cell.kind)}{value}>{cell.html}</th>'
    return f"<td{_class(cell.kind)}{value}>{cell.html}</td>"


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def definitions(pairs: Sequence[tuple[str, str]], code: str = "") -> str:
    """Return a list of names and plain text; the one called ``code`` is shown as code."""
    items = "".join(f"<dt>{escape(k)}</dt><dd>"
                    + (f"<code>{escape(v)}</code>" if k == code else escape(v)) + "</dd>"
                    for k, v in pairs if v)
    return f"<dl>{items}</dl>" if items else ""


def bullets(lines: Sequence[str]) -> str:
    """Return a list of plain lines."""
    items = "".join(f"<li>{escape(t)}</li>" for t in lines)
    return f'<ul class="plain">{items}</ul>' if items else ""


def paragraph(text: str, kind: str = "") -> str:
    """Return one paragraph of plain text, nothing for none."""
    return f"<p{_class(kind)}>{escape(text)}</p>" if text else ""


def error_bar(error: float | None, tolerance: float | None, sigma: float | None) -> str:
    """Return a small bar: the error against its tolerance, with the 95 % interval.

    The shaded zone is one tolerance to each side of nominal, the ends are three.
    """
    if error is None or tolerance is None or not tolerance > 0.0:
        return ""
    half = 1.96 * (sigma or 0.0)

    def at(value: float) -> float:
        return 65.0 + 20.0 * max(-2.9, min(2.9, value / tolerance))

    x, far = at(error), abs(error) > 3.0 * tolerance
    mark = (f'<circle class="err" cx="{x:.1f}" cy="9" r="3.5"/>' if not far else
            f'<path class="err far" d="M{x:.1f} 4v10l{5 if error > 0 else -5} -5z"/>')
    label = f"error {sig(error)}, tolerance {sig(tolerance)}"
    return (f'<svg class="bar" role="img" aria-label="{label}" viewBox="0 0 130 18">'
            f'<title>{label}</title><rect class="zone" x="45" y="3" width="40" height="12"/>'
            f'<path class="zero" d="M65 1v16"/>'
            f'<path class="ci" d="M{at(error - half):.1f} 9H{at(error + half):.1f}"/>{mark}</svg>')


DRAWINGS = """
svg text{font-family:system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif;
font-size:11px;fill:var(--soft)}
svg text.name{fill:var(--ink);font-size:11.5px}svg text.small{font-size:9.5px}
.grid{stroke:var(--line);stroke-width:1;fill:none}
.axis,.mark{stroke:var(--soft);stroke-width:1;fill:none}.mark{stroke-dasharray:3 3;opacity:.7}
.dot{stroke-width:4;stroke-linecap:round;fill:none}.dot.before{stroke-width:3.4}
.stroke{stroke-width:1.5;fill:none}.stroke.light{opacity:.35}.stroke.thin{stroke-width:1}
.line{fill:none;stroke-width:1.2;stroke-linejoin:round}
path.before,polyline.before{stroke:var(--before)}path.after,polyline.after{stroke:var(--after)}
path.out{stroke:var(--out);stroke-width:1.6}
path.ink,polyline.ink{stroke:var(--ink)}polyline.faint{stroke:var(--soft);opacity:.5}
path.area.after{fill:var(--after);stroke:none;opacity:.75}
.area.band{fill:var(--band);stroke:none}
.r-before{fill:none;stroke:var(--before);stroke-width:1.4}
.r-after,.r-named{fill:var(--after)}.r-more{fill:none;stroke:var(--after);stroke-width:1.4}
.r-alternative{fill:none;stroke:var(--out);stroke-width:1.4;stroke-dasharray:4 2}
.r-explained{fill:var(--before);opacity:.65}.r-other{fill:var(--soft);opacity:.6}
.r-changed{fill:var(--out)}
.limit{stroke:var(--ink);stroke-width:1.2;fill:none}.limit.dotted{stroke-dasharray:2 2}
.ring{fill:var(--card);stroke:var(--before);stroke-width:1.5}.disc{fill:var(--after)}
text.strong{fill:var(--ink);font-weight:600}text.ink{fill:var(--ink)}text.title{font-size:13px}
"""
"""The look of drawings, in the page and outside of it; colours by name, see :data:`LIGHT`."""

_TOP = """
:root{color-scheme:light dark;--page:#f6f7f8;--card:#fff;--ink:#1c2227;--soft:#5a6670;
--line:#dde2e6;--head:#eef1f3;--before:#b3692a;--after:#1f62a6;--out:#c2293a;--ok:#23744a;
--warn:#8f5a00;--warnbg:#fff6e3;--band:#1f62a61f}
@media(prefers-color-scheme:dark){:root{--page:#14181b;--card:#1b2125;--ink:#e4e9ec;
--soft:#9fabb4;--line:#323b42;--head:#232b30;--before:#e0a063;--after:#6fb0f2;--out:#ff7f8a;
--ok:#6cc796;--warn:#f0bf63;--warnbg:#2d2717;--band:#6fb0f22b}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--page);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",sans-serif}
main{max-width:1240px;margin:0 auto;padding:20px 16px 48px}
h1{font-size:14px;font-weight:600;color:var(--soft);margin:0 0 6px}
h2{font-size:20px;line-height:1.3;margin:36px 0 4px}
h3{font-size:15px;margin:22px 0 6px}
p{margin:6px 0;max-width:78ch}
.lead p{font-size:18px;line-height:1.45;margin:0 0 8px}.big{font-size:17px;font-weight:600}
.soft,.note{color:var(--soft)}.note{font-size:13.5px;max-width:120ch}
code{font:13px/1.4 ui-monospace,SFMono-Regular,Menlo,Consolas,"DejaVu Sans Mono",monospace;
overflow-wrap:anywhere}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,300px),1fr));gap:12px;
margin:14px 0}
.tile{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:10px 14px}
.tile .what{font-size:13px;color:var(--soft)}
.tile .flow{font-size:18px;font-weight:600;font-variant-numeric:tabular-nums}
.tile .flow i{font-style:normal;font-weight:400;color:var(--soft);padding:0 5px}
.tile .more{font-size:13px;color:var(--soft)}
.look{background:var(--warnbg);border-left:4px solid var(--warn);border-radius:4px;
padding:10px 16px;margin:14px 0}
.look h2,.fine h2{font-size:15px;margin:0 0 4px}
.look ul{margin:0;padding-left:20px}.look li{margin:3px 0;overflow-wrap:anywhere}
.fine{border-left:4px solid var(--ok);padding:8px 16px;margin:14px 0;background:var(--card);
border-radius:4px}
.scroll{overflow-x:auto;background:var(--card);border:1px solid var(--line);border-radius:8px;
margin:8px 0;max-width:100%;width:fit-content}
table{border-collapse:collapse;font-size:13.5px;line-height:1.35}
caption{text-align:left;color:var(--soft);padding:8px 10px 4px;font-size:13px}
th,td{padding:5px 10px;border-top:1px solid var(--line);text-align:left;vertical-align:top;
white-space:nowrap}
td.wrap{white-space:normal;min-width:16em;max-width:60em}td.mid{white-space:nowrap}
thead th{background:var(--head);font-weight:600;border-top:0;vertical-align:bottom;
white-space:normal}
tbody th{font-weight:500;position:sticky;left:0;background:var(--card);white-space:normal;
max-width:19em;z-index:1}
tbody th.n{font-weight:400;color:var(--soft)}
.narrow tbody th:first-child{white-space:nowrap}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}
td.warn{color:var(--warn);font-weight:600}td.bad,.bad{color:var(--out);font-weight:600}.good{color:var(--ok)}
th button{font:inherit;color:inherit;background:none;border:0;padding:0;cursor:pointer;
text-align:inherit}
th button:hover,th button:focus-visible{text-decoration:underline}
th[aria-sort=ascending] button:after{content:" \\2191"}
th[aria-sort=descending] button:after{content:" \\2193"}
.plots{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,340px),1fr));gap:14px;
margin:10px 0}
.story{columns:340px;column-gap:14px;margin:10px 0}.story b{color:var(--ink)}
.story figure{break-inside:avoid;margin:0 0 14px}
summary{cursor:pointer}details{margin:10px 0}
.pair{display:flex;flex-wrap:wrap;gap:4px 36px;align-items:flex-start}
.pair>*{min-width:0}.pair>div+div{flex:1 1 380px}
figure{margin:0;background:var(--card);border:1px solid var(--line);border-radius:8px;
padding:10px 8px 8px;max-width:600px}
figcaption{font-size:13px;color:var(--soft);padding:2px 8px 0}
.legend{white-space:nowrap;color:var(--ink)}
.key{display:inline-block;width:9px;height:9px;border-radius:50%;margin:0 4px 0 2px;
background:currentColor}
.key+.key{margin-left:8px}
.key.before{color:var(--before)}.key.after{color:var(--after)}
.key.ring{background:none;border:2px solid var(--before)}
.key.out{color:var(--out);border-radius:0;transform:rotate(45deg) scale(.75)}
svg.plot{display:block;width:100%;height:auto}
.pictures{display:grid;gap:14px;margin:10px 0;align-items:start;
grid-template-columns:repeat(auto-fit,minmax(min(100%,430px),max-content))}
.picture{background:#fff;border-color:#dde2e6;max-width:100%}
.picture figcaption{color:#5a6670;max-width:60ch}
.picture img{display:block;max-width:100%;height:auto}
"""
_REST = """
svg.bar{width:116px;height:16px;display:block}
@media(min-width:900px){tbody th{white-space:nowrap;max-width:none}
wbr{display:none}td,th{padding:5px 9px}}
.bar .zone{fill:var(--band)}.bar .zero{stroke:var(--soft);stroke-width:1}
.bar .err{fill:var(--after)}.bar .err.far{fill:var(--out)}
.bar .ci{stroke:var(--ink);stroke-width:1.5;fill:none}
dl{display:grid;grid-template-columns:max-content 1fr;gap:2px 16px;margin:8px 0;font-size:14px}
dt{color:var(--soft)}dd{margin:0;overflow-wrap:anywhere;min-width:0}
ul.plain{padding-left:20px;margin:6px 0}ul.plain li{margin:2px 0;overflow-wrap:anywhere}
footer{margin-top:40px;color:var(--soft);font-size:13px}
@media(max-width:520px){.lead p{font-size:16.5px}dl{grid-template-columns:1fr}dd{margin-bottom:6px}
th,td{padding:5px}table{font-size:13px}tbody th{max-width:9.5em}
.pair>div+div{flex-basis:100%}td.wrap{min-width:12em}}
@media print{:root{--page:#fff;--card:#fff;--ink:#000;--soft:#444;--line:#bbb;--head:#eee;
--before:#b3692a;--after:#1f62a6;--out:#c2293a;--warnbg:#fff;--warn:#8f5a00;--ok:#23744a;
--band:#1f62a61f}
body{font-size:10.5pt}main{max-width:none;padding:0}.scroll{overflow:visible;border:0}
table{font-size:8.5pt}th button:after{content:""}figure,tr,.tile{break-inside:avoid}
h2,h3{break-after:avoid}th,td{padding:3px 6px;white-space:normal}tbody th{position:static}
.plots{grid-template-columns:1fr 1fr}svg.bar{width:90px}}
"""

CSS = _TOP + DRAWINGS + _REST
LIGHT = dict(re.findall(r"--(\w+):([^;}]+)", _TOP.partition("}")[0]))
"""Colour names and values of the page by day."""

SCRIPT = """
document.querySelectorAll('table.sort').forEach(function(t){
t.querySelectorAll('thead th').forEach(function(h,i){
if(!h.textContent)return;
var b=document.createElement('button');b.type='button';b.title='Sort';
while(h.firstChild)b.appendChild(h.firstChild);h.appendChild(b);
b.onclick=function(){var up=h.getAttribute('aria-sort')!=='ascending';
t.querySelectorAll('thead th').forEach(function(o){o.removeAttribute('aria-sort')});
h.setAttribute('aria-sort',up?'ascending':'descending');
var k=function(r){var c=r.cells[i];return c.dataset.v!==undefined?+c.dataset.v:c.textContent};
var rows=Array.from(t.tBodies[0].rows);
rows.sort(function(p,q){var a=k(p),b=k(q),na=typeof a==='number',nb=typeof b==='number';
if(na!==nb)return na?-1:1;
var d=na?a-b:String(a).localeCompare(String(b),'en',{numeric:true});return up?d:-d});
rows.forEach(function(r){t.tBodies[0].appendChild(r)})}})});
"""
