"""A drawing of a machine as HTML, and what a page needs once to show any number of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from ppmcal.io.results.scene import Scene, SceneFrame
from ppmcal.report.html import script_json as script_json
from ppmcal.report.html import template_macro, template_text
from ppmcal.wording import number, pluralize

LIBRARY = "vendor/plotly.min.js"
"""Draws in 2D and 3D; a page holds one copy."""
SCRIPTS = ("machine_core.js", "machine_limbs.js", "machine_points.js", "machine.js")
DIGITS = 7
"""Digits that are drawn; more where differences are magnified."""


def scene_html(scene: Scene, index: int | str = "") -> str:
    """Return one drawing; names in it are escaped.

    Args:
        scene: machines and measured rows.
        index: of the identification on the page, by which its rows are known.
    """
    order = slider_order(scene)
    return template_macro("machine_scene.html", "drawing", scene, index, order, findings(scene),
                          _notes(scene), script_json({**_content(scene), "order": order}))


def machine_css() -> str:
    """Return the style of all drawings on a page."""
    return template_text("machine.css")


def machine_scripts(library: bool = True) -> Markup:
    """Return the scripts for all drawings of a page, to stand behind the last of them.

    Args:
        library: whether to bring plotly along; else the page has it before.
    """
    texts = [template_text(LIBRARY)] if library else []
    texts.append("".join(template_text(name) for name in SCRIPTS))
    return Markup("".join(f"<script>{text}</script>\n" for text in texts))


def page_scripts(sections: Sequence[str], library: bool = True) -> Markup:
    """Return the scripts that the drawings among some sections need, nothing without any."""
    drawn = any('<div class="machine"' in section for section in sections)
    return machine_scripts(library) if drawn else Markup("")


def slider_order(scene: Scene) -> list[int]:
    """Return the poses in the slider's order.

    About home each coordinate from below through home to above, then the measured ones.
    """
    out, group = [0], list[int]()
    frames = scene.machines[0].frames
    for n in range(1, scene.about_home):
        group.append(n)
        last = n + 1 == scene.about_home or _moved(frames[n + 1]) != _moved(frames[n])
        if last:
            down = [m for m in group if "−" in frames[m].label]
            out += [*down, 0, *(m for m in group if m not in down), 0]
            group = []
    about = out[:-1] if len(out) > 1 else out
    return [*about, *range(scene.about_home, len(frames))]


def _moved(frame: SceneFrame) -> str:
    return frame.label.split(" ")[0]


def findings(scene: Scene) -> list[str]:
    """Return what needs a look, in words: at home, and how often at the other poses."""
    frames = scene.machines[0].frames
    out = [f"At home {mark.text}." for mark in frames[0].marks if mark.kind != "shared"]
    at_home = {(mark.kind, mark.limbs) for mark in frames[0].marks}
    elsewhere: dict[tuple[str, tuple[int, ...]], list[tuple[str, str]]] = {}
    for frame in frames[1:]:
        for mark in frame.marks:
            if (mark.kind, mark.limbs) not in at_home:
                elsewhere.setdefault((mark.kind, mark.limbs), []).append((frame.label, mark.text))
    for found in elsewhere.values():
        label, text = found[0]
        more = f", and at {pluralize(len(found) - 1, 'other pose')}" if len(found) > 1 else ""
        out.append(f"At {label}{more}: {text}.")
    return out


def _notes(scene: Scene) -> list[str]:
    out = list(scene.notes)
    shared = [m.text for m in scene.machines[0].frames[0].marks if m.kind == "shared"]
    if shared:
        out.append(f"Joints in one place: {', '.join(shared)}. Right where they are one joint; "
                   "else a point of theirs is wrong.")
    if len(scene.machines) > 1:
        out.append(f"Over the {scene.machines[0].name} machine: {scene.machines[1].name}, at the "
                   f"same joint values, their differences drawn {number(scene.magnification, 6)} "
                   "times as large.")
    if scene.still:
        out.append(f"Not moved, because the machine decides them or reaches no such pose: "
                   f"{', '.join(scene.still)}.")
    return out


def _content(scene: Scene) -> dict[str, Any]:
    """Return what the page holds of a scene: as many digits as are seen, nothing empty."""
    digits = DIGITS + math.ceil(math.log10(max(scene.magnification, 1.0)))
    content = scene.entries(whole=True)
    for key in ("machines", "measured", "effects"):
        content[key] = _short(content[key], min(digits, 15))
    return content


def _short(value: Any, digits: int) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, Mapping):
        return {k: _short(v, digits) for k, v in value.items()
                if v is not None and v != "" and v != [] and v != ()}
    if isinstance(value, list | tuple):
        return [_short(v, digits) for v in value]
    return value
