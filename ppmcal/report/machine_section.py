"""The section in which an identification's machine is drawn, with measured rows and next poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ppmcal.errors import PpmcalError
from ppmcal.io import read_mechanism
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import group_name, own_values, together
from ppmcal.io.results.knowledge import model_in
from ppmcal.io.results.scene import Scene
from ppmcal.io.results.scene_machine import QUIET, SceneEffect, SceneFrame, SceneMachine
from ppmcal.io.results.scene_rows import POINTS, placed_rows, with_next, with_poses
from ppmcal.linalg import Array
from ppmcal.model.effects import GEOMETRY, effect_kinds
from ppmcal.model.instruments import number_names
from ppmcal.model.mechanism import Effect, Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.plotting.canvas import WIDTH, Drawing
from ppmcal.plotting.layers import Layer, Marks, Polyline
from ppmcal.plotting.plot import BOTTOM, LEFT, RIGHT, TOP, Axis, Plot, span
from ppmcal.report.diagnosis_tables import amounts
from ppmcal.report.html import paragraph, template_macro, template_text, with_label
from ppmcal.report.html import script_json as script_json
from ppmcal.report.records import Diagnosed, Identified
from ppmcal.wording import actuator_list, number, pluralize

LIBRARY = "vendor/plotly.min.js"
"""Draws in 2D and 3D; a page holds one copy."""
SCRIPTS = ("machine_core.js", "machine_limbs.js", "machine_points.js", "machine.js")
DIGITS = 7
"""Digits that are drawn; more where differences are magnified."""


def scene_html(scene: Scene, index: int | str = "") -> str:
    """Return one drawing; ``index``: of the identification on the page, as its rows know it."""
    order = slider_order(scene)
    return template_macro("machine_scene.html", "drawing", scene, index, order, findings(scene),
                          _notes(scene), script_json({**_content(scene), "order": order}))


def machine_css() -> str:
    """Return the style of all drawings on a page."""
    return template_text("machine.css")


def machine_scripts(library: bool = True) -> Markup:
    """Return the scripts for all drawings of a page, behind the last; ``library``: and plotly."""
    texts = [template_text(LIBRARY)] if library else []
    texts.append("".join(template_text(name) for name in SCRIPTS))
    return Markup("".join(f"<script>{text}</script>\n" for text in texts))


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
    out = [f"At home {mark.text}." for mark in frames[0].marks if mark.kind not in QUIET]
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
    marks = scene.machines[0].frames[0].marks
    for kind, what, right in (("shared", "Joints in one place", "are one joint"),
                              ("touching", "Links that touch at home", "are drawn so")):
        limbs = [m.text for m in marks if m.kind == kind]
        if limbs:
            out.append(f"{what}: {', '.join(limbs)}. Right where they {right}; else a point of "
                       "theirs is wrong.")
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


VIEWS = ((0, 2, "from the front"), (0, 1, "from above"))
"""Axes to the right and up of the sides that a spatial machine is seen from."""
LEAST, MOST = 100.0, 330.0
"""Height of a view, points."""
GAP = np.full((1, 3), np.nan)


def machine_drawings(one: Identified) -> list[Drawing]:
    """Return the machine in its plane or from two sides, nothing where the folder holds none."""
    path = model_in(Path(one.folder))
    if path is None:
        return []
    scene = Scene.of(read_mechanism(path), present="identified")
    return [_view(scene, a, b, side) for a, b, side in
            (((0, 1, ""),) if scene.flat else VIEWS)]


def _view(scene: Scene, a: int, b: int, side: str) -> Drawing:
    """Return the machine at home, seen along one axis."""
    lines, joints = zip(*_placed(scene), strict=True)
    several, layers = len(scene.machines) > 1, list[Layer]()
    for n, (machine, parts, at) in enumerate(zip(scene.machines, lines, joints, strict=True)):
        kind = ("before", "after")[n] if several else "ink"
        base, platform, links = parts
        layers += [Polyline(base[:, a], base[:, b], "", kind, 0.8, True),
                   Polyline(links[:, a], links[:, b], machine.name if several else "", kind),
                   Polyline(platform[:, a], platform[:, b], "", kind, 2.2),
                   Marks(at[:, a], at[:, b], kind, "o", 3.0)]
    every = np.concatenate([*joints, *(p for parts in lines for p in parts)])
    x, y, height = _square(every[:, a], every[:, b])
    names = [with_label("xyz"[i], scene.units.length) for i in (a, b)]
    unit, seen = scene.units.length, f", {side}" if side else ""
    drawn = (f" Nominal and identified at the same joint values, their differences drawn "
             f"{number(scene.magnification, 6)} times as large." if several else "")
    return Plot(x, y, (names[0], names[1]), layers, (unit, unit), height=TOP + height + BOTTOM,
                equal=True).drawing(
        f"The machine at home{seen}",
        f"Circles: joints; thick lines: platform; dashed: base.{drawn}",
        f"{len(scene.machines[0].limbs)} limbs of {scene.name} to scale.")


def _placed(scene: Scene) -> Iterator[tuple[tuple[Array, Array, Array], Array]]:
    """Yield lines (base, platform, links) and joints of each machine, (N, 3) each, file units.

    Differences from the first machine are magnified.
    """
    first = _points(scene.machines[0])
    for machine in scene.machines:
        base, platform, links, joints = (
            p + (scene.magnification - 1.0) * (p - p0) if p.shape == p0.shape else p
            for p, p0 in zip(_points(machine), first, strict=True))
        yield (base, platform, links), joints


def _points(machine: SceneMachine) -> tuple[Array, Array, Array, Array]:
    """Return base, platform, links and joints of a machine at home, (N, 3) each."""
    frame = machine.frames[0]
    links = [p for limb in frame.limbs for link in limb.links for p in (*link, GAP[0])]
    joints = [p for limb in frame.limbs for p in limb.joints]
    return (_outline(frame, "base", machine.base_outline),
            _outline(frame, "platform", machine.platform_outline),
            np.array(links, dtype=float).reshape(-1, 3),
            np.array(joints, dtype=float).reshape(-1, 3))


def _outline(frame: SceneFrame, side: str, order: tuple[int, ...]) -> Array:
    """Return the points of one side as a closed line (N + 1, 3)."""
    points = np.array([getattr(frame.limbs[i], side) for i in order], dtype=float).reshape(-1, 3)
    return np.concatenate([points, points[:1]])


def _square(x: Array, y: Array) -> tuple[Axis, Axis, float]:
    """Return axes with equal scales that hold the points, and the height of the plot."""
    wide, across, up = WIDTH - LEFT - RIGHT, span(x), span(y)
    own = wide * (up.high - up.low) / (across.high - across.low)
    height = float(np.clip(own, LEAST, MOST))
    return (_wider(across, max(own / height, 1.0)), _wider(up, max(height / own, 1.0)), height)


def _wider(axis: Axis, times: float) -> Axis:
    middle, half = 0.5 * (axis.low + axis.high), 0.5 * times * (axis.high - axis.low)
    return Axis(middle - half, middle + half)


POSES, FEWEST, BUDGET = 60, 12, 120
"""So many measured poses are drawn at most and at least; so many on a page of several machines."""


def machine_section(one: Identified, index: int, diagnosed: Sequence[Diagnosed] = (),
                    machines: int = 1) -> str:
    """Return the drawing of an identification's machine as HTML, without a heading.

    Nominal and identified machine lie over each other, measured rows are points coloured by their
    error, effects are lit where they sit. Empty where the folder holds no machine.

    Args:
        one: the identification.
        index: its index on the page, by which its rows are known.
        diagnosed: diagnoses of the page; that of the same folder names the effects.
        machines: how many are drawn on the page, so that it does not grow with them.
    """
    path = model_in(Path(one.folder))
    if path is None:
        return ""
    try:
        mechanism = read_mechanism(path)
        record = next((d.record for d in diagnosed if d.folder == one.folder), None)
        scene = machine_scene(one, index, mechanism, record, machines)
    except PpmcalError as error:
        what = error.what
        return paragraph(f"The machine of {path.name} cannot be drawn: {what}.", "note")
    return scene_html(scene, index)


def machine_scene(one: Identified, index: int, mechanism: Mechanism,
                  record: DiagnosisRecord | None = None, machines: int = 1) -> Scene:
    """Return the scene of an identification; see :func:`machine_section`."""
    most = max(POINTS // max(machines // 2, 1), POINTS // 8)
    rows = placed_rows(one, index, mechanism, most)
    count = max(FEWEST, min(POSES, BUDGET // max(machines, 1)))
    points, poses = with_poses(mechanism, rows, count)
    notes = list(rows.notes)
    if points:
        notes = [_what_is_drawn(mechanism, len(poses.keys), len(points)), *notes]
    if one.next is not None and one.next.size:
        notes.append(Note(
            "Diamonds: where the platform stands at the poses to measure next, next.csv.", NOTE))
    poses = with_next(poses, one.next, mechanism)
    return Scene.of(mechanism, points, _value(one), mechanism.units.length, poses,
                    scene_effects(mechanism, record), "identified", notes)


def _value(one: Identified) -> str:
    """Return what the points are coloured by."""
    heads = () if one.residuals is None else one.residuals.header
    kinds = [k for k in number_names() if f"after_{k}" in heads]
    return " or ".join((["position error"] if "after_x" in heads else []) + [
        f"{k} error" for k in kinds]) or "position error"


def _what_is_drawn(mechanism: Mechanism, poses: int, points: int) -> Note:
    without = ", its effects left out," if mechanism.effects else ""
    return Note(
        f"Each of {points} points stands where the identified machine{without} has the "
        "measured point at the row's joint values, in the base's frame; its arrow is the error "
        "of residuals.csv, measured minus predicted, magnified as the switch says. The slider "
        f"goes through poses about home, then {poses} of the measured ones. Click a point to "
        "find its row.", NOTE)


def scene_effects(mechanism: Mechanism, record: DiagnosisRecord | None) -> list[SceneEffect]:
    """Return what the model has beside geometry: as a diagnosis names it, then as its file does."""
    out, told = [], set[tuple[str, frozenset[str]]]()
    for group in together(record) if record is not None else []:
        assert record is not None
        on = list(dict.fromkeys(a for e in group for a in e.on))
        size = own_values(group).replace("+-", "±") or "; ".join(
            f"{name} {text}".strip() for e in group for name, text in amounts(e))
        told |= {(e.kind, frozenset(e.on)) for e in group}
        told.add((group[0].kind, frozenset(on)))
        name = group_name(record, group)
        limbs = _limbs(mechanism, on) or tuple(
            i for i, limb in enumerate(mechanism.limbs)
            if group[0].kind == GEOMETRY and any(p.startswith(f"{limb.name}.")
                                                 for e in group for p in e.parameters))
        out.append(_effect(group[0].kind, name, f"{name}: {size}" if size else name, limbs))
    for effect in mechanism.effects:
        on = [a for a, used in zip(mechanism.actuators, effect.on, strict=True) if used]
        if (effect.kind.name, frozenset(on)) not in told:
            name = _name(mechanism, effect, on)
            out.append(_effect(effect.kind.name, name, f"{name}: {_size(mechanism, effect)}",
                               _limbs(mechanism, on)))
    # what sits in one place is lit first
    return sorted(out, key=lambda e: len(e.limbs) or len(mechanism.limbs))


def _effect(kind: str, name: str, text: str, limbs: tuple[int, ...]) -> SceneEffect:
    known = effect_kinds().get(kind.split(" ")[0])
    if known is not None and not known.per_actuator:
        return SceneEffect(name=name, text=text, body=known.body)
    return SceneEffect(name=name, text=text, limbs=limbs)


def _limbs(mechanism: Mechanism, on: Sequence[str]) -> tuple[int, ...]:
    """Return the limbs that these actuators drive."""
    return tuple(i for i, limb in enumerate(mechanism.limbs)
                 if limb.driven and mechanism.actuators[limb.actuator] in on)


def _name(mechanism: Mechanism, effect: Effect, on: Sequence[str]) -> str:
    place = actuator_list(on, len(mechanism.actuators)) if effect.kind.per_actuator else ""
    return f"{effect.kind.label} on {place}" if place else effect.kind.label


def _size(mechanism: Mechanism, effect: Effect) -> str:
    """Return the values of an effect's parameters, file units."""
    said = []
    for name, p in list(effect.parameters.items())[:4]:
        parameter = mechanism.parameters[p]
        unit = mechanism.units.name(parameter.quantity)
        value = parameter.value / mechanism.units.factor(parameter.quantity)
        said.append(f"{name} {number(value)} {'' if unit == '1' else unit}".rstrip())
    more = len(effect.parameters) - len(said)
    return ", ".join(said) + (f" and {more} more" if more > 0 else "")
