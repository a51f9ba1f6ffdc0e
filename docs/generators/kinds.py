"""Pages of limb kinds and of effects, from their registries."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import math
import re

import yaml

from generators.keys import EXAMPLES as ALL_EXAMPLES
from generators.markdown import code, fenced, plain, table
from generators.paths import ROOT
from ppmcal.io.limb_reader import limb_kind
from ppmcal.model.effects import EffectKind, EffectParameter, effect_kinds
from ppmcal.model.limbs import LimbKind, kinds
from ppmcal.model.limbs.chain import SlotSpec
from ppmcal.model.motions import motions

DRIVES = {"length": "slide", "angle": "hinge"}
EXAMPLES = ALL_EXAMPLES["effects"]
WORDS = {"dir": "`dir_<actuator>`", "vel": "`vel_<actuator>`", "temperature": "`temperature`",
         "load": "`payload` or a wrench",
         "tension": "`tension_<rope>`, or the load if no limb is redundant",
         "wrench": "`payload` or a wrench", "time": "`time`",
         "row": "the rows in order", "touch": "touches of a flat (instrument `plane`)",
         "order": "`approach: sequence`, or `time`", "past": "`time`, of every row of the file"}
LIMBS = """# Limb kinds

Joints are named from base to platform, the driven one in parentheses. A is `base.point`, B is
`platform.point` transformed to base axes, u = `ratio` q + `offset` the joint coordinate,
d(φ) = (cos φ, sin φ), n(φ) = (−sin φ, cos φ), α = `base.angle`, σ = `slide_angle`,
ψ = the platform's rotation + `platform.angle`. The drawings show one limb of a shipped machine, and
in grey its position with a larger joint value. A kind without parentheses is passive
(`actuator: none`): it constrains the platform and has no joint value.

Conditions on directions, such as `platform.axis` perpendicular to `base.axis`, are given as the arc
at 1 m in tables of gaps.

A limb's slots are named after it: `leg1.base.point.x`, `leg1.length`. Lengths and angles are in
the units of the file. In addition, each joint of a limb has a frame error, `joint1: {x, y, z,
rx, ry, rz}`, 0 by default.
"""
EFFECTS = """## Kind by kind

Each kind as defined in the program. Ranges are in SI units. `q` is the joint value, `du` the
contribution to the joint coordinate; other symbols are defined [above](#what-they-are).
"""


def anchor_of(kind: LimbKind) -> str:
    """Return the anchor of a limb kind: its letters, the driven one capital in words."""
    plain_name = re.sub(r"[ ()]+", "-", kind.name).strip("-")
    return f"limb-{plain_name.lower()}"


def limb_page() -> str:
    """Return the page of all limb kinds."""
    listed = table(["kind", "driven", "closes when"], [
        (f"[{k.name}](#{anchor_of(k)})", DRIVES.get(k.actuator, "none"),
         code(k.closes_when)) for k in kinds().values()])
    return "\n".join([LIMBS, listed, *map(_limb, kinds().values())])


def _limb(kind: LimbKind) -> str:
    slots = [(code(s.name), s.quantity, "needed" if s.default is None else f"{s.default:g}",
              f"`{s.tolerance_class}`", _slot(s)) for s in kind.slots]
    further = [(code(d), "direction", "needed", "`angle`" if d not in kind.axes_without_errors else
                "", DIRECTIONS.get(d, f"a unit vector in {d.partition('.')[0]} axes"))
               for d in kind.directions]
    further += [(code(a), "direction", "none", "`angle`", "first axis of a universal joint whose "
                 "axes do not intersect") for a in kind.axes if a not in kind.directions]
    branch = [] if kind.branch is None else [
        (code(kind.branch), "1 or -1", "nearest to `home.q`, else 1", "",
         "which of two solutions")]
    machine, limb = example_limb(kind)
    return "\n".join([
        f"## {kind.name} {{ #{anchor_of(kind)} }}\n",
        f"![One limb {kind.name}, and its position after {'its' if kind.driven else 'another'} "
        f"joint value has increased]"
        f"(images/generated/{anchor_of(kind)}.svg)\n",
        f"Closes when {code(kind.closes_when)}. Source: {kind.source}.\n",
        table(["slot", "measures", "default", "tolerance class", "meaning"],
              [*slots, *further, *branch]),
        f"From `{machine}`, which `ppmcal init {machine.removesuffix('.yaml')}` writes:\n",
        fenced(yaml.safe_dump([limb], sort_keys=False, default_flow_style=None, width=88))])


SLOTS = {"lateral": "distance of the strut or slide from the joint", "offset": "zero of the "
         "drive: added to ratio q", "ratio": "joint coordinate per joint value; 1: in the file's "
         "unit", "length": "of the rod", "proximal": "from the base's joint to the middle one",
         "distal": "from the middle joint to the platform's", "slide_angle": "between slide and "
         "link", "base.angle": "of the slide, from the base's x axis", "platform.angle":
         "of the slide, from the platform's x axis", "radius": "of the pulley, to the centre "
         "line of the rope"}
DIRECTIONS = {
    "base.pulley.axis": "a unit vector in base axes, about which the rope runs round the pulley "
    "like right-hand fingers round the thumb",
    "base.pulley.zero": "a unit vector in base axes, from the centre to where the rope meets "
    "the pulley",
    "base.swivel_pulley.axis": "a unit vector in base axes, about which the pulley swivels: along "
    "the arriving rope, in its direction"}
PULLEYS = {"center": "centre of the pulley, in base axes",
           "point": "where the rope meets the pulley, on its swivel axis, in base axes"}


def _slot(slot: SlotSpec) -> str:
    if slot.name.endswith("axis_offset"):
        return "distance between the axes of the universal joint"
    *_, body, point, _ = ("", "", *slot.name.split("."))
    if body.endswith("pulley") and point in PULLEYS:
        return PULLEYS[point]
    if ".point." in slot.name:
        return f"joint of the {slot.name.partition('.')[0]}, in its axes"
    if slot.name.rpartition(".")[2] in ("rx", "ry", "rz"):
        return f"error of {slot.name.rpartition('.')[0]}: a small rotation in its axes"
    return SLOTS["radius" if slot.wheel else slot.name]


def example_limb(kind: LimbKind) -> tuple[str, dict[str, object]]:
    """Return a shipped machine's file name and its first limb of a kind.

    Raises:
        LookupError: no shipped machine has such a limb.
    """
    for path in sorted((ROOT / "configs").glob("*.yaml"), key=lambda p: (len(p.stem), p.stem)):
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
        for limb in tree.get("limbs", ()) if "motion" in tree else ():
            if kind is limb_kind(limb, motions()[tree["motion"]], path.name):
                return path.name, limb
    raise LookupError(f"no machine in configs/ has a limb {kind.name}")


def effect_sections() -> str:
    """Return one section for each effect kind."""
    return "\n".join([EFFECTS, *map(_effect, sorted(effect_kinds().values(),
                                                    key=lambda k: k.name))])


def _effect(kind: EffectKind) -> str:
    own = kind.motions
    forms = [kind, *(v for m in own for v in (kind.variants(m) if kind.variants else ()))]
    specs = {s.name: s for form in forms for m in own if form.exists_in(m)
             for s in form.parameters(m)}
    rows = [(code(s.name), _unit(s.quantity), "needed" if s.default is None else
             "open" if math.isnan(s.default) else f"{s.default:g}", _usual(s), plain(s.why))
            for s in specs.values()]
    needs = " and ".join(dict.fromkeys(WORDS[n] for n in kind.needs)) or "only joint values"
    facts = [f"- Adds: {code(kind.equation)}", f"- Source: {plain(kind.source)}.",
             f"- Needs: {needs}.",
             f"- Acts on: {'single actuators (`on`)' if kind.per_actuator else 'the machine'}; "
             f"motions: {', '.join(map(str, own))}."]
    if kind.from_file:
        facts.append(f"- Further keys: {', '.join(map(code, kind.from_file.entries))}.")
    if kind.remedy:
        facts.append(f"- To distinguish it: {plain(kind.remedy)}.")
    first = " ".join(_about(kind).partition("\n\n")[0].split())
    return "\n".join([
        f"### {kind.name}\n", plain(first) + "\n", "\n".join(facts) + "\n",
        table(["parameter", "unit", "default", "expected range", "why"], rows) if rows else "",
        fenced(f"effects:\n  - {effect_line(kind.name)}") if kind.name in EXAMPLES else ""])


def effect_line(name: str) -> str:
    """Return an entry of `effects` for a kind, as a file may have it."""
    raw = {"kind": name, **EXAMPLES[name]}
    text = yaml.safe_dump(raw, sort_keys=False, default_flow_style=True, width=10_000).strip()
    return text.replace("'on'", "on")


def _about(kind: EffectKind) -> str:
    """Return what the kind's module says of it; of another package's, its equation."""
    name = f"ppmcal.model.effects.{kind.name}"
    if importlib.util.find_spec(name) is None:
        return kind.equation
    return inspect.getdoc(importlib.import_module(name)) or ""


def _unit(quantity: str) -> str:
    """Return a quantity as a unit in words: ``joint/load`` -> joint unit per N or N m."""
    words = {"length": "length", "angle": "angle", "joint": "joint's unit",
             "load": "N or N m", "1": "1", "": "1", "time": "s"}
    head, _, tail = quantity.partition("/")
    out = words.get(head, head)
    return f"{out} per {words.get(tail, tail)}" if tail else out


def _usual(spec: EffectParameter) -> str:
    low, high = spec.usual
    if not (math.isfinite(low) or math.isfinite(high)):
        low, high = spec.low, spec.high
    if not (math.isfinite(low) or math.isfinite(high)):
        return ""
    of = " of the stroke" if spec.of_stroke else " / stroke" if spec.per_stroke else ""
    ends = [f"{v:g}" if math.isfinite(v) else "" for v in (low, high)]
    return f"{ends[0]} to {ends[1]}{of}" if all(ends) else (
        f"{ends[0]} or more{of}" if ends[0] else f"{ends[1]} or less{of}")
