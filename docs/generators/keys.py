"""Pages of every file's keys, from the JSON Schemas that `ppmcal schema` prints."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from generators.markdown import anchor, code, fenced, plain, table
from generators.paths import DOCS
from ppmcal.commands.schema.run import FILES, file_schema
from ppmcal.io.yaml import read_yaml

Schema = Mapping[str, Any]

FILE_NAMES = {"mechanism": "Mechanism file", "dataset": "Sidecar of measurements",
              "scenario": "Scenario file", "batch": "Manifest of a batch",
              "about": "About a certificate"}
LEADS = {
    "mechanism": "The machine as drawn, or as identified. `ppmcal init` writes one to "
    "start from, `ppmcal check` checks it. Everything is in the units that `units` declares. "
    "The keys of `limbs` depend on their kind: see [limb kinds](limbs.md); so do the parameters of "
    "`effects`: see [effects](../effects.md#kind-by-kind).",
    "dataset": "The YAML file next to a CSV of the same stem, which describes its numbers. The "
    "columns are listed in [data as they come](../data.md#columns).",
    "scenario": "What `ppmcal simulate` simulates: poses, errors, effects, instrument, noise.",
    "batch": "The campaigns that `ppmcal batch` runs; see [Many machines](../batch.md).",
    "about": "Who certifies what, for `ppmcal certify --about`; see "
    "[Certificates](../certify.md).",
}
TITLES = {"AboutInstrumentFile": "Measuring instrument", "PoseFile": "Pose",
          "SlotFile": "Slot", "DirectionFile": "Direction",
          "ValueFile": "Value of an effect's parameter"}
UNITS = {
    "length": ("x", "y", "z", "position", "height", "distance", "radius", "diameter", "pitch",
               "point", "target", "to_point"),
    "angle": ("rx", "ry", "rz", "rotation", "target_rotation", "angle"),
    "kg": ("payload",), "°C": ("mean",), "K": ("swing",),
    "the slot's": ("value", "tolerance", "nominal", "sigma"),
    "the joint's": ("q", "limits", "actuator", "offset"),
    "joint's per s": ("velocity",),
    "N per length": ("bar", "drive"),
}
WHOLE = {
    "mechanism": "format name units motion limbs home tolerances limits",
    "dataset": "format name units instrument frame target",
    "scenario": "format units poses errors instrument frame target approach seed",
    "batch": "format model campaigns options",
    "about": "format units number machine customer laboratory instrument date operator "
             "temperature decision",
}
"""What of a file its page shows at the top."""
EXAMPLES: dict[str, Any] = read_yaml(DOCS / "generators" / "examples.yaml")
"""File -> part -> key -> an example; parts as :func:`parts` names them."""


def key_page(name: str) -> str:
    """Return the page of one file's keys."""
    schema = file_schema(name)
    found = list(parts(name))
    whole = {key: EXAMPLES[name][""][key] for key in WHOLE[name].split()}
    lines = [f"# {FILE_NAMES[name]}\n", LEADS[name] + "\n",
             f"`ppmcal schema {name}` prints the JSON Schema, for editors. A key that is not "
             "listed is refused, with the most similar one that is.\n",
             fenced(yaml.safe_dump(whole, sort_keys=False, default_flow_style=None, width=88))]
    for title, part in found:
        if title:
            lines += [f"## {title}\n", plain(part.get("description", "").replace("``", "")) + "\n"]
        needed = part.get("required", schema.get("then", {}).get("required", ())
                          if not title else ())
        rows = [(code(key), plain(description(one, schema)),
                 ", ".join(w for w in (_kind(one, dict(found)), unit_of(title, key)) if w),
                 "needed" if key in needed else _default(one),
                 code(shortened(_text(example(name, title, key)))))
                for key, one in part["properties"].items()]
        lines.append(table(["key", "meaning", "type, unit", "default", "example"], rows))
    return "\n".join(lines)


def example(name: str, part: str, key: str) -> object:
    """Return an example of a key in a part of a file; empty where there is none."""
    own = EXAMPLES[name].get(part) or EXAMPLES["shared"].get(part, {})
    return own.get(key, "")


def parts(name: str) -> Iterator[tuple[str, Schema]]:
    """Yield (title, schema) of each mapping that a file may hold, the whole file first as ''.

    Limbs and parameters of effects depend on kinds, and have pages of their own.
    """
    schema = file_schema(name)
    yield "", schema
    seen: list[str] = []

    def reached(node: object) -> None:
        if isinstance(node, list):
            for one in node:
                reached(one)
        elif isinstance(node, Mapping):
            target = str(node.get("$ref", "")).rpartition("/")[2]
            if target and target not in seen:
                seen.append(target)
                reached(schema["$defs"][target])
            for key, one in node.items():
                if key != "$defs":
                    reached(one)

    reached(schema)
    for target in seen:
        own = schema["$defs"][target]
        if "properties" in own and not target.startswith("limb "):
            yield title_of(target), own


def title_of(definition: str) -> str:
    """Return the heading of a definition: ``SigmaFile`` -> ``Sigma``."""
    name = definition.removesuffix("File")
    return TITLES.get(definition, f"{name.removesuffix('Options')} options"
                      if name.endswith("Options") and name != "Options" else name)


def resolved(one: Schema, schema: Schema) -> Schema:
    """Return what a reference stands for."""
    target = str(one.get("$ref", "")).rpartition("/")[2]
    return schema["$defs"][target] if target else one


def description(one: Schema, schema: Schema) -> str:
    """Return a key's description, or that of the definition that it refers to."""
    return str(one.get("description") or resolved(one, schema).get("description", ""))


def unit_of(part: str, key: str) -> str:
    """Return the unit of a number, as far as its name tells; empty for a bare one."""
    if part == "Sigma" and key == "actuator":
        return "the joint's"
    if part == "Tolerances":
        return {"point": "length", "length": "length", "angle": "angle",
                "offset": "the joint's"}.get(key, "")
    if part in ("Read", "Units", "Noise", "Cost"):
        return ""
    return next((unit for unit, keys in UNITS.items() if key in keys), "")


def _kind(one: Schema, known: Mapping[str, Schema]) -> str:
    """Return what may stand there, in words."""
    if "$ref" in one:
        title = title_of(one["$ref"].rpartition("/")[2])
        return f"[{title}](#{anchor(title)})" if title in known else {
            "Slot": "number or [slot](#slot)"}.get(title, title.lower())
    if "const" in one:
        return code(one["const"])
    if "enum" in one:
        words = [code(w) for w in one["enum"]]
        return ", ".join(words) if len(words) <= 8 else f"one of {len(words)} words"
    if "anyOf" in one:
        return " or ".join(dict.fromkeys(_kind(o, known) for o in one["anyOf"]))
    if one.get("type") == "array":
        inner = _kind(one.get("items", {}), known)
        return f"list of {inner}" if inner else "list"
    if one.get("type") == "object":
        own = one.get("additionalProperties")
        return f"mapping to {_kind(own, known)}" if isinstance(own, Mapping) else "mapping"
    return {"string": "text", "boolean": "`true` or `false`", "integer": "whole number"}.get(
        str(one.get("type", "")), str(one.get("type", "")))


def _default(one: Schema) -> str:
    if "default" not in one:
        return ""
    default = one["default"]
    return "" if default in ({}, [], None) or isinstance(default, Mapping) else code(_text(default))


def shortened(text: str, width: int = 72) -> str:
    """Return text that is no wider than a table bears."""
    return text if len(text) <= width else f"{text[:width - 4].rstrip()} ..."


def _text(value: object) -> str:
    """Return a value as YAML writes it in a line."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool | int | float):
        return json.dumps(value) if value not in (float("inf"),) else ".inf"
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000).strip()


def key_pages() -> dict[str, str]:
    """Return file name -> page of all files."""
    return {f"{name}.md": key_page(name) for name in FILES}
