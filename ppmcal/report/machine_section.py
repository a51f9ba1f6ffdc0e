"""The section in which an identification's machine is drawn, with measured rows and next poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ppmcal.errors import PpmcalError
from ppmcal.io import read_mechanism
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import group_name, own_values, together
from ppmcal.io.results.scene import Scene, SceneEffect
from ppmcal.io.results.scene_rows import POINTS, FittedRows, placed_rows, with_next, with_poses
from ppmcal.model.effects import GEOMETRY, effect_kinds
from ppmcal.model.mechanism import Effect, Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.report.diagnosis_tables import amounts
from ppmcal.report.html import paragraph
from ppmcal.report.machine_scene import scene_html
from ppmcal.report.records import Diagnosed, Identified
from ppmcal.wording import actuator_list, number

MODELS = ("model.yaml", "identified.yaml")
"""Files that hold the machine of a folder, the one with effects first."""
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
    path = machine_file(one)
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


def machine_file(one: Identified) -> Path | None:
    """Return the file of an identification's machine, None where its folder holds none."""
    return next((p for p in (Path(one.folder) / m for m in MODELS) if p.is_file()), None)


def machine_scene(one: Identified, index: int, mechanism: Mechanism,
                  record: DiagnosisRecord | None = None, machines: int = 1) -> Scene:
    """Return the scene of an identification; see :func:`machine_section`."""
    most = max(POINTS // max(machines // 2, 1), POINTS // 8)
    rows = placed_rows(FittedRows(one.folder, one.record, one.residuals), index, mechanism, most)
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
    kinds = [k for k in ("height", "distance") if f"after_{k}" in heads]
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
        size = own_values(record, group).replace("+-", "±") or "; ".join(
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
