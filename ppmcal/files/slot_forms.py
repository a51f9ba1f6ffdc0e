"""How a limb kind's slots group into points, directions and joint frames, and point forms."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter, ValidationError

from ppmcal.errors import BadInput, unknown
from ppmcal.files.mechanism_schema import SlotFile
from ppmcal.files.schema import Word, show
from ppmcal.model.limbs import LimbKind
from ppmcal.model.limbs.chain import SlotSpec

TURNS = ("rx", "ry", "rz")


def groups(kind: LimbKind) -> list[tuple[str, list[SlotSpec]]]:
    """Return the slots of a kind in order, points, directions and joint frames together."""
    out: dict[str, list[SlotSpec]] = {}
    for spec in (*kind.slots, *kind.joint_slots):
        head, _, tail = spec.name.rpartition(".")
        together = head.endswith("point") or head in kind.directions or (
            head.startswith("joint") and tail in ("x", "y", "z", *TURNS))
        out.setdefault(head if together else spec.name, []).append(spec)
    return list(out.items())


def point_parts(raw: Any, axes: list[str], place: str) -> dict[str, Any]:
    """Return axis (or radius, angle) -> raw slot of a point, in parameter order."""
    example = "[" + ", ".join(["0"] * len(axes)) + "]"
    forms = (f"Write {example} with your numbers, {{{', '.join(f'{a}: ..' for a in axes)}}}, or "
             f"{{radius: .., angle: ..{', z: ..' if 'z' in axes else ''}}}")
    if raw is None:
        raise BadInput("the point is missing", place, forms)
    if isinstance(raw, list):
        if len(raw) != len(axes):
            raise BadInput(f"the point has {len(raw)} coordinates instead of {len(axes)}", place,
                           forms)
        return dict(zip(axes, raw, strict=True))
    if not isinstance(raw, dict):
        raise BadInput(f"{show(raw)} is not a point", place, forms)
    if "value" in raw or "share" in raw:
        return _spread_point(raw, axes, place)
    polar = "radius" in raw or "angle" in raw
    names = ["radius", "angle", *axes[2:]] if polar else axes
    for key in raw:
        if key not in names:
            raise unknown("key", key, names if polar else [*axes, "radius", "angle", "value"],
                          place)
    for name in names:
        if name not in raw:
            raise BadInput(f"the point lacks '{name}'", place, forms)
    return {name: raw[name] for name in names}


def _spread_point(raw: dict[Any, Any], axes: list[str], place: str) -> dict[str, Any]:
    """Return one slot per axis from ``{value: [x, y], tolerance: 0.2, share: NAME}``."""
    allowed = list(SlotFile.model_fields)
    out: dict[str, dict[str, Any]] = {axis: {} for axis in axes}
    for key, value in raw.items():
        if key not in allowed:
            raise unknown("key", key, allowed, place)
        for i, axis in enumerate(axes):
            one = value
            if isinstance(value, list):
                if len(value) != len(axes):
                    raise BadInput(f"the list has {len(value)} numbers instead of {len(axes)}",
                                   f"{place}.{key}", "Give one for each coordinate")
                one = value[i]
            elif key in ("value", "nominal"):
                raise BadInput(f"{show(value)} is not a list of {len(axes)} numbers",
                               f"{place}.{key}", "Give one number for each coordinate")
            out[axis][key] = f"{one}.{axis}" if key == "share" else one
    return out


def word(value: object, place: str) -> str:
    """Return a name that can stand in a column header and in a parameter path."""
    try:
        return str(TypeAdapter(Word).validate_python(value))
    except ValidationError as error:
        context = error.errors()[0].get("ctx", {})
        raise BadInput(str(context.get("what", error)), place,
                       str(context.get("mend", ""))) from None
