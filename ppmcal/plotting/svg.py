"""A figure as SVG: compact, text as text, with the colours of the page or as a file of its own."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from matplotlib.figure import Figure

from ppmcal.plotting.style import PAGE, look, plain

FONTS = "system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif"
SCALE = 1.6
"""Size in pixels of one point of a file's drawing, as a browser first shows it."""
_HREF = "{http://www.w3.org/1999/xlink}href"
_BARE = dict.fromkeys(("Date", "Creator", "Format", "Type"))
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
_DEFAULTS = (("text-anchor", "start"), ("font-size", "11px"))
_OWN = re.compile(r"[\w.]+_\d+")
"""Names that matplotlib gives to groups by itself."""


def svg(drawn: Figure, title: str, description: str = "", page: bool = False) -> str:
    """Return a figure as SVG, one unit a point, with its title for those who cannot see it.

    Markers of one look are one path, coordinates have a tenth of a point, and there are no ids:
    any number of drawings can stand in one page. Words that were given to a text as its gid
    are told on hovering. With ``page`` there is no ground, colours go by the page's names and
    letters are the page's.

    Raises:
        ValueError: something is clipped, hatched or an image, which needs ids or more room.
    """
    source = ElementTree.fromstring(_source(drawn, page))
    width, height = (short(72.0 * size) for size in drawn.get_size_inches())
    root = Element("svg", {"role": "img", "viewBox": f"0 0 {width} {height}",
                           "font-size": "11px"})
    if page:
        root.attrib |= {"class": "plot", "aria-label": plain(title)}
    else:
        root.attrib |= {"xmlns": "http://www.w3.org/2000/svg", "font-family": FONTS,
                        "width": short(SCALE * float(width)),
                        "height": short(SCALE * float(height))}
    SubElement(root, "title").text = plain(title)
    SubElement(root, "desc").text = plain(description)
    marks = {f"#{m.get('id')}": m.get("d", "") for m in source.iter() if m.get("id")}
    done: dict[tuple[str, str], Element] = {}
    root.extend(list(_shapes(source, marks, done, page)))
    return ElementTree.tostring(root, encoding="unicode") + ("" if page else "\n")


def short(value: float) -> str:
    """Return a coordinate with a tenth of a point."""
    return f"{value + 0.0:.1f}".removesuffix(".0").replace("-0.0", "0")


def _source(drawn: Figure, page: bool) -> str:
    """Return what matplotlib makes of it."""
    stream = io.StringIO()
    drawn.patch.set_visible(not page)
    with look():
        drawn.savefig(stream, format="svg", metadata=_BARE)
    return stream.getvalue()


def _shapes(group: Element, marks: dict[str, str], done: dict[tuple[str, str], Element],
            page: bool) -> Iterator[Element]:
    """Yield the paths and texts of a group, those of its groups among them."""
    for node in group:
        tag = node.tag.rpartition("}")[2]
        if node.get("clip-path") or tag in ("clipPath", "pattern", "image"):
            raise ValueError(f"a drawing may not hold a clipped '{tag}', a hatching or an image")
        style = _style(node.get("style", ""), page)
        if tag == "g":
            hover = node.get("id", "")
            for shape in _shapes(node, marks, done, page):
                if shape.tag == "text" and hover and not _OWN.fullmatch(hover):
                    SubElement(shape, "title").text = hover
                yield shape
        elif tag == "path":
            yield Element("path", d=_path(node.get("d", "")), style=style)
        elif tag == "text":
            yield _text(node, style)
        elif tag == "use":
            name = node.get(_HREF, "")
            d = _moved(marks[name], float(node.get("x", 0.0)), float(node.get("y", 0.0)))
            if (name, style) in done:
                path = done[name, style]
                path.set("d", path.get("d", "") + d)
            else:
                done[name, style] = Element("path", d=d, style=style)
                yield done[name, style]


def _style(text: str, page: bool) -> str:
    """Return a style in few letters; what is default here is left out."""
    parts = [p.partition(": ")[::2] for p in text.split("; ") if p]
    return ";".join(f"{name}:{_colour(value) if page else value}" for name, value in parts
                    if name not in ("font-family", "stroke-linejoin")
                    and (name, value) not in _DEFAULTS)


def _colour(value: str) -> str:
    return f"var(--{PAGE[value]})" if value in PAGE else value


def _text(node: Element, style: str) -> Element:
    """Return words at their place, with a rotation where they have one."""
    place = _NUMBER.sub(lambda m: short(float(m[0])), node.get("transform", ""))
    turned = "rotate(" in place and "rotate(0 " not in place
    out = Element("text", {"style": style} | ({"transform": place} if turned else {}))
    if not (turned and "translate" in place):
        out.attrib |= zip("xy", _NUMBER.findall(place)[-2:], strict=True)
    out.text = node.text
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
