"""JSON Schemas of the files, for editors that complete and check YAML.

They come from the classes that read the files, and from the limb and effect kinds that are
registered: what ``ppmcal schema`` prints knows the kinds of other packages too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from ppmcal.errors import refuse_unknown
from ppmcal.io.effects import EffectFile, limb_entries
from ppmcal.io.frame_definitions import POINTS
from ppmcal.io.limb_reader import NO_DRIVE
from ppmcal.io.mechanism_blocks import PARTS, TRANSLATIONS, joint_names, parts_of
from ppmcal.io.mechanism_schema import DirectionFile, MechanismFile, SlotFile, SlotGroup, groups
from ppmcal.io.pose_fields import PoseFile
from ppmcal.io.scenario_schema import ScenarioFile
from ppmcal.io.sidecar import SidecarFile
from ppmcal.model.effects import GEOMETRY, effect_kinds
from ppmcal.model.instruments import instruments
from ppmcal.model.limbs import LimbKind, kinds
from ppmcal.model.limbs.chain import JOINT_COMPONENTS
from ppmcal.model.motions import SPATIAL

Schema = dict[str, Any]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
SLOT, POINT, DIRECTION, POSE = ({"$ref": f"#/$defs/{name}"}
                                for name in ("Slot", "Point", "Direction", "PoseFile"))
FILES = ("mechanism", "dataset", "scenario")
NUMBER: Schema = {"type": "number"}
VECTOR: Schema = {"type": "array", "items": NUMBER, "minItems": 2, "maxItems": 3}
NAMED = "Name of the limb; parameters begin with it."
AXES = {"x": "Along x.", "y": "Along y.", "z": "Along z.",
        "radius": "Distance from the z axis, in place of x and y.",
        "angle": "Angle from x towards y, beside `radius`."}
TWIST = {c: f"Shift along {c}." if c in "xyz" else f"Small turn about {c[1]}."
         for c in JOINT_COMPONENTS}
SPRINGS = {"bar": "N per unit of length along the limb's contact line; .inf: rigid.",
           "drive": "Of the drive: N per unit of length, N m per unit of angle; .inf: rigid."}


def file_schema(name: str) -> Schema:
    """Return the JSON Schema of the files ``mechanism``, ``dataset`` or ``scenario``.

    Raises:
        BadInput: there is no such file.
    """
    refuse_unknown("file", [name], FILES)
    return {"mechanism": _mechanism, "dataset": _dataset, "scenario": _scenario}[name]()


def _of(model: type[BaseModel], title: str) -> Schema:
    """Return the schema of a file's class with the definitions that all files share."""
    out = model.model_json_schema()
    definitions = out.setdefault("$defs", {})
    for part in (SlotFile, DirectionFile, PoseFile, EffectFile):
        own = part.model_json_schema()
        definitions |= own.pop("$defs", {})
        definitions[part.__name__] = own
    definitions["Slot"] = {
        "description": "A number, or a mapping with value, tolerance, ...",
        "anyOf": [NUMBER, {"$ref": "#/$defs/SlotFile"}]}
    definitions["Point"] = _point()
    definitions["Direction"] = {"anyOf": [VECTOR, {"$ref": "#/$defs/DirectionFile"}]}
    definitions["Effect"] = _effect(definitions.pop("EffectFile"))
    return finished(out, title)


def finished(out: Schema, title: str) -> Schema:
    """Return the schema of a file that people write, under its own title."""
    without_null(out)
    return {"$schema": DIALECT, "title": title, **{k: v for k, v in out.items() if k != "title"}}


def without_null(node: Any) -> None:
    """Drop the null that stands for "not given": in YAML the key is left out."""
    if isinstance(node, dict):
        kinds_ = node.get("anyOf")
        if isinstance(kinds_, list) and {"type": "null"} in kinds_:
            rest = [k for k in kinds_ if k != {"type": "null"}]
            node.pop("anyOf")
            if len(rest) == 1:
                node.update({k: v for k, v in rest[0].items() if k not in node})
            else:
                node["anyOf"] = rest
            if node.get("default", 0) is None:
                node.pop("default")
        if node.get("default", 0) is None and set(node) <= {"default", "title", "description"}:
            node.pop("default")
        for value in node.values():
            without_null(value)
    elif isinstance(node, list):
        for value in node:
            without_null(value)


def _mechanism() -> Schema:
    out = _of(MechanismFile, "ppmcal mechanism")
    properties = out["properties"]
    properties["limbs"]["items"] = _limbs(out["$defs"])
    properties["effects"] |= {"type": "array", "items": {"$ref": "#/$defs/Effect"}}
    properties["stiffness"] |= _springs(tuple(dict.fromkeys(
        joint for kind in kinds().values() for joint in joint_names(kind))))
    properties["extends"] |= {"type": "string"}
    out["$defs"]["ClosureFile"]["properties"]["sigma"] |= _one_or_each()
    out["$defs"]["HomeFile"]["properties"]["pose"] |= POSE
    out["$defs"]["RegistrationFile"]["properties"]["frame"] |= POSE
    # what a file that extends another leaves out is there
    needed = out.pop("required")
    return {**out, "if": {"not": {"required": ["extends"]}}, "then": {"required": needed}}


def _one_key(key: str, schema: Schema, **others: Schema) -> Schema:
    """Return an object that has a key, and perhaps others."""
    return {"type": "object", "properties": {key: schema, **others}, "required": [key],
            "additionalProperties": False}


def _dataset() -> Schema:
    out = _of(SidecarFile, "ppmcal data set (the YAML beside a CSV)")
    _places(out["properties"])
    out["properties"]["frame"]["anyOf"] += [_one_key("same_as", {
        "type": "string", "description": "Name of the data set whose frame it is too."}),
        _one_key("points", {"type": "object", "additionalProperties": False,
                            "required": [*POINTS][:2], "description": "Points of the base as the "
                            "instrument measured them, which define its frame.", "properties": {
                                name: {**VECTOR, "description": f"{what[:1].upper()}{what[1:]}."}
                                for name, what in POINTS.items()}}, sigma={
            **NUMBER, "description": "Standard deviation of each coordinate of the points  "
                                     "[default: the instrument's]."}),
        _one_key("first_pose", {"enum": [True], "description": "The base is where the nominal "
                                "machine is right at the first pose."})]
    about = {"type": "object", "required": ["value", "sigma"], "additionalProperties": False,
             "properties": {
                 "value": {**NUMBER, "description": "Measured over true lengths, as far as known."},
                 "sigma": {**NUMBER, "description": "Standard deviation of `value`."}}}
    out["properties"]["scale"] |= {"anyOf": [{"enum": ["known", "unknown"]}, NUMBER, about]}
    instrument = out["$defs"]["InstrumentFile"]["properties"]
    instrument["point"] |= {"anyOf": [VECTOR, {"enum": ["known", "unknown"]}]}
    instrument["offset"] |= {"anyOf": [NUMBER, {"enum": ["known", "unknown"]}]}
    # of what shows no place there is nothing to say of where it stands
    needed = [key for key in ("frame", "target") if key in out["required"]]
    out["required"] = [key for key in out["required"] if key not in needed]
    placeless = [k.name for k in instruments().values() if k.inside or not k.of_poses]
    out["if"] = {"properties": {"instrument": {
        "description": "What shows no place.", "properties": {"kind": {
            "description": "Its kind.", "enum": placeless}}}}}
    out["else"] = {"required": needed}
    out["$defs"]["SigmaFile"]["properties"]["actuator"] |= _one_or_each()
    return out


def _scenario() -> Schema:
    out = _of(ScenarioFile, "ppmcal scenario")
    _places(out["properties"])
    out["properties"]["effects"] |= {"type": "array", "items": {"$ref": "#/$defs/Effect"}}
    out["properties"]["errors"] |= {"type": "object"}
    for name in ("CircleFile", "GridFile", "RandomFile", "HelixFile"):
        own = out["$defs"][name]["properties"]
        for key in ("center", "swing", "half_range"):
            if key in own:
                own[key] |= POSE
    out["$defs"]["PosesFile"] |= {"minProperties": 1, "maxProperties": 1}
    out["$defs"]["ScenarioSigmaFile"]["properties"]["actuator"] |= _one_or_each()
    instrument = out["$defs"]["ScenarioInstrumentFile"]["properties"]
    instrument["offset"] |= {"anyOf": [NUMBER, {"enum": ["known"]}]}
    conditions = out["$defs"]["ConditionsFile"]["properties"]
    conditions["velocity"] |= _one_or_each()
    for key, single in (("payload", NUMBER), ("temperature", NUMBER)):
        own = conditions[key]
        hint = {k: own.pop(k) for k in ("description", "title", "default") if k in own}
        conditions[key] = {**hint, "anyOf": [single, dict(own)]}
    return out


def _places(properties: dict[str, Schema]) -> None:
    """Say what frame, target and target_rotation may be."""
    known: Schema = {"enum": ["known", "unknown"]}
    properties["frame"] |= {"anyOf": [known, POSE]}
    for key in ("target", "target_rotation"):
        properties[key] |= {"anyOf": [known, VECTOR]}


def _one_or_each() -> Schema:
    return {"anyOf": [NUMBER, {"type": "object", "additionalProperties": NUMBER}]}


def _limbs(definitions: dict[str, Schema]) -> Schema:
    """Return what one limb may be: which keys it has depends on its kind."""
    names = sorted(kinds())
    for name in names:
        definitions[f"limb {name}"] = _limb(kinds()[name])
    choose = [{"if": {"properties": {"kind": {"const": name}}, "required": ["kind"]},
               "then": _of_those_called_so(name, definitions)} for name in names]
    return {"type": "object", "required": ["name"], "properties": {
        "name": {"type": "string", "description": NAMED},
        "kind": {"enum": names, "description": "Joints from base to platform; the driven one in "
                                               "brackets."}},
        "allOf": choose}


def _of_those_called_so(name: str, definitions: Mapping[str, Schema]) -> Schema:
    """Return what a limb of a kind may be, or of several that files call alike."""
    own = kinds()[name]
    alike = [name] if not own.written else sorted(
        k.name for k in kinds().values() if k.written == own.written)
    listed: list[Schema] = [{"$ref": f"#/$defs/limb {one}"} for one in alike]
    return listed[0] if len(listed) == 1 else {"anyOf": listed}


def _limb(kind: LimbKind) -> Schema:
    """Return the keys of one kind of limb."""
    properties: dict[str, Schema] = {
        "name": {"type": "string", "description": NAMED},
        "kind": {"description": "Joints from base to platform.", **(
            {"type": "string"} if kind.written else {"const": kind.name})},
        "actuator": {"type": "string", "description": "Joint variable  [default: the name]; limbs "
                                                      "may have one in common."}
        if kind.driven else {"const": NO_DRIVE, "description": "A passive limb has no drive."},
        "stiffness": _springs(joint_names(kind), parts_of(kind))}
    if kind.branch:
        properties[kind.branch] = {"enum": [1, -1], "description": "Which of two solutions."}
    for name in limb_entries(kind):
        spec = next(s for s in effect_kinds()[kind.effect].parameters(SPATIAL) if s.name == name)
        properties[name] = {"anyOf": [NUMBER, {"$ref": "#/$defs/ValueFile"}], "description":
                            f"{spec.quantity}, of {kind.effect}."}
    further = (SlotGroup(d, "direction", ()) for d in kind.zeros.values())
    for group in (*groups(kind), *further):
        *above, last = group.path.split(".")
        part = properties
        for depth, key in enumerate(above):
            part = part.setdefault(key, {
                "type": "object", "additionalProperties": False, "properties": {},
                "description": "What the rope leaves over." if depth else
                f"What the {key} carries of the limb, in {key} axes."})["properties"]
        part[last] = _group(group)
    return {"type": "object", "description": f"{kind.name}: {kind.closes_when} ({kind.source}).",
            "properties": properties, "additionalProperties": False}


def _group(group: SlotGroup) -> Schema:
    path, body = group.path, group.path.partition(".")[0]
    if group.form == "direction":
        return {**DIRECTION, "description": f"A direction in {body} axes."}
    if group.form == "first axis":
        return {**DIRECTION, "description": f"First axis of the {body}'s universal joint, in "
                                            f"{body} axes."}
    if group.form == "joint frame":
        return {"type": "object", "additionalProperties": False,
                "description": f"Error of the frame of {path}, in its own axes.",
                "properties": {c: {**SLOT, "description": TWIST[c]} for c in group.parts}}
    if group.form == "point":
        return {**POINT, "description": f"{path}: [x, y, z], {{x, y, z}} or {{radius, angle, z}}."}
    spec = group.slots[0]
    default = "" if spec.default is None else f"  [default: {spec.default:g}]"
    return {**SLOT, "description": f"{spec.name}, {spec.quantity}{default}."}


def _point() -> Schema:
    slots = {name: {**SLOT, "description": text} for name, text in AXES.items()}
    slot_keys = SlotFile.model_json_schema()["properties"]
    lists: Schema = {"anyOf": [NUMBER, VECTOR]}
    return {"anyOf": [
        {"type": "array", "items": SLOT, "minItems": 2, "maxItems": 3},
        {"type": "object", "properties": slots, "additionalProperties": False},
        {"type": "object", "additionalProperties": False, "properties": {
            key: {"description": one["description"], **(
                {"type": "string"} if key == "share" else {"type": "boolean"}
                if key == "fixed" else lists)} for key, one in slot_keys.items()}}]}


def _springs(joints: tuple[str, ...], own_parts: tuple[str, ...] = PARTS) -> Schema:
    """Return ``stiffness``: N per unit of length or N m per unit of angle; .inf: rigid."""
    components = {c: {**NUMBER, "description": "N per unit of length." if c in TRANSLATIONS else
                      "N m per unit of angle."} for c in JOINT_COMPONENTS}
    components["value"] = {**NUMBER, "description": f"{', '.join(TRANSLATIONS)} alike."}
    one: Schema = {"anyOf": [NUMBER, {
        "type": "object", "additionalProperties": False, "properties": components}]}
    parts = {part: {**NUMBER, "description": SPRINGS[part]} for part in own_parts}
    own = {joint: {**one, "description": "Of that joint's frame, in its own axes, z along the "
                                         "joint."} for joint in joints}
    return {"type": "object", "additionalProperties": False,
            "description": f"Springs; one number for a joint: {', '.join(TRANSLATIONS)} alike.",
            "properties": {**parts, **own}}


def _effect(base: Mapping[str, Any]) -> Schema:
    """Return one effect: which parameters it has depends on its kind."""
    value: Schema = {"anyOf": [NUMBER, {"$ref": "#/$defs/ValueFile"}]}
    choose = []
    for name, kind in sorted(effect_kinds().items()):
        # what an entry of the file makes of a kind has parameters of its own
        words = {s.name: s.quantity for motion in kind.motions
                 for one in (kind, *(kind.variants(motion) if kind.variants else ()))
                 if one.exists_in(motion) for s in one.parameters(motion)}
        choose.append({
            "if": {"properties": {"kind": {"const": name}}, "required": ["kind"]},
            "then": {"properties": {"parameters": {
                "type": "object", "additionalProperties": False, "properties": {
                    key: {**value, "description": f"{quantity or 'bare number'}."}
                    for key, quantity in words.items()}}}}})
    names = [*sorted(effect_kinds()), GEOMETRY]
    entries: dict[str, list[str]] = {}
    for name, kind in sorted(effect_kinds().items()):
        for entry in kind.from_file.entries if kind.from_file else ():
            entries.setdefault(entry, []).append(name)
    further = {n: {"description": f"Of {', '.join(of)}."} for n, of in entries.items()}
    own = {**base["properties"], **further,
           "kind": {"enum": names, "description": "Kind of the effect."},
           "parameters": {"type": "object", "description": "Sizes, by name; those of the kind."}}
    return {**base, "additionalProperties": False, "properties": own, "allOf": choose}

