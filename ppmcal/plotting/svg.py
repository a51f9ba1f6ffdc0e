"""A figure as SVG: compact, text as text."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from matplotlib.figure import Figure

from ppmcal.plotting.style import look, plain

FONTS = "system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif"
SCALE = 1.6
"""Size in pixels of one point of a file's drawing, as a browser first shows it."""
TOLD = "told: "
_HREF = "{http://www.w3.org/1999/xlink}href"
_BARE = dict.fromkeys(("Date", "Creator", "Format", "Type"))
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
_DEFAULTS = (("text-anchor", "start"), ("font-size", "11px"))


def svg(drawn: Figure, title: str, description: str = "", scale: float = SCALE,
        unit: str = "") -> str:
    """Return a figure as SVG, one unit a point, with its title for those who cannot see it.

    As a browser first shows it a point is ``scale`` pixels, or of another ``unit``.

    Markers of one look are one path, coordinates have a tenth of a point, and there are no ids:
    any number of drawings can stand in one page. A text whose gid is :data:`TOLD` and words
    tells them on hovering.

    Raises:
        ValueError: something is clipped, hatched or an image, which needs ids or more room.
    """
    stream = io.StringIO()
    with look():
        drawn.savefig(stream, format="svg", metadata=_BARE)
    source = ElementTree.fromstring(stream.getvalue())
    width, height = (short(72.0 * size) for size in drawn.get_size_inches())
    root = Element("svg", {
        "role": "img", "viewBox": f"0 0 {width} {height}", "font-size": "11px",
        "xmlns": "http://www.w3.org/2000/svg", "font-family": FONTS,
        "width": short(scale * float(width)) + unit,
        "height": short(scale * float(height)) + unit})
    SubElement(root, "title").text = plain(title)
    SubElement(root, "desc").text = plain(description)
    root.extend(list(_shapes(source)))
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def short(value: float) -> str:
    """Return a coordinate with a tenth of a point."""
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def _shapes(source: Element) -> Iterator[Element]:
    """Yield paths and texts, from the lowest to the uppermost."""
    marks: dict[str, str] = {}
    done: dict[tuple[str, str], Element] = {}
    hover = ""
    for node in source.iter():
        tag, name = node.tag.rpartition("}")[2], node.get("id", "")
        if tag == "image" or node.get("clip-path") or "url(" in node.get("style", ""):
            raise ValueError("a drawing may hold nothing clipped or hatched and no image")
        style = _style(node.get("style", ""))
        if tag == "g":
            hover = name
        elif tag == "path" and name:
            marks[f"#{name}"] = node.get("d", "")
        elif tag == "path":
            yield Element("path", d=_path(node.get("d", "")), style=style)
        elif tag == "text":
            yield _text(node, style, hover.removeprefix(TOLD) if hover.startswith(TOLD) else "")
        elif tag == "use":
            kind = node.get(_HREF, ""), style
            d = _moved(marks[kind[0]], float(node.get("x", 0.0)), float(node.get("y", 0.0)))
            if kind in done:
                done[kind].set("d", done[kind].get("d", "") + d)
            else:
                done[kind] = Element("path", d=d, style=style)
                yield done[kind]


def _style(text: str) -> str:
    """Return a style in few letters; what is default here is left out."""
    parts = [p.partition(": ")[::2] for p in text.split("; ") if p]
    return ";".join(f"{name}:{value}" for name, value in parts
                    if name not in ("font-family", "stroke-linejoin")
                    and (name, value) not in _DEFAULTS)


def _text(node: Element, style: str, hover: str) -> Element:
    """Return words at their place, with a rotation where they have one."""
    place = _NUMBER.sub(lambda m: short(float(m[0])), node.get("transform", ""))
    turned = "rotate(" in place and "rotate(0 " not in place
    out = Element("text", {"style": style} | ({"transform": place} if turned else {}))
    if not (turned and "translate" in place):
        out.attrib |= zip("xy", _NUMBER.findall(place)[-2:], strict=True)
    out.text = node.text
    if hover:
        SubElement(out, "title").text = hover
    return out


def _path(d: str) -> str:
    """Return a path with few digits; dots and upright lines in fewer words."""
    d = _NUMBER.sub(lambda m: short(float(m[0])), d)
    d = re.sub(r"\s*([A-Za-z])\s*", r"\1", d).strip()
    d = re.sub(r"M(\S+) (\S+)L\1 \2(?=M|$)", r"M\1 \2h0", d)
    return re.sub(r"M(\S+) (\S+)L\1 ([-\d.]+)", r"M\1 \2V\3", d)


def _moved(d: str, x: float, y: float) -> str:
    """Return a marker's path at a place; its coordinates come in pairs."""
    at = iter((x, y) * (len(d) // 2))
    return _path(_NUMBER.sub(lambda m: f"{float(m[0]) + next(at):.6f}", d))
