"""The slots of a limb in a file: which stand together under a path, and what may stand there.

Declared here for the reader, the writer and the JSON Schema; which slots there are is the limb
kind's to say (:class:`ppmcal.model.limbs.chain.SlotSpec`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from ppmcal.errors import BadInput, refuse_unknown, unknown
from ppmcal.io.schema import DEVIATION, Flag, Number, Path, Sigma, Strict, refuse, show, vector
from ppmcal.model.limbs import LimbKind
from ppmcal.model.limbs.chain import SlotSpec

TURNS = ("rx", "ry", "rz")
"""Components of the small rotation that is a direction's error."""
POINTS = ("point", "center")
"""Last words of paths that are points."""
Form = Literal["direction", "first axis", "joint frame", "point", "number"]


class SlotFile(Strict):
    """One slot: ``120`` or ``{value: 120, tolerance: 0.2, fixed: true}``."""

    value: Number | None = None
    """Present value, in the file's unit of length or angle."""
    tolerance: Sigma | None = None
    """Standard deviation of the part from its nominal value; .inf: no prior."""
    fixed: Flag | None = None
    """Whether identification must leave it as it is."""
    nominal: Number | None = None
    """Value of the drawing, where `value` is an identified one."""
    sigma: Sigma | None = None
    """Standard deviation of `value` after identification."""
    share: Path | None = None
    """Name of a parameter that several slots have in common."""


def _three_sigmas(value: object) -> list[float]:
    values = value if isinstance(value, list) else [value] * 3
    if len(values) != 3:
        raise refuse(f"a number or a list of 3 is needed here, this has {len(values)}",
                     "Write one standard deviation, or [rx, ry, rz]")
    return [DEVIATION(one) for one in values]


class DirectionFile(Strict):
    """A unit vector: ``[0, 0, 1]`` or with its error, a small rotation in base axes.

    The machine's direction is Rot(``rotation``) ``value``; ``nominal`` is the nominal
    direction; ``sigma`` and ``tolerance`` belong to the rotation's rx, ry, rz.
    """

    value: Annotated[list[float], vector(3)] | None = None
    """The direction; it need not have length 1."""
    nominal: Annotated[list[float], vector(3)] | None = None
    """The direction of the drawing."""
    rotation: Annotated[list[float], vector(3)] | None = None
    """Small rotation in base axes that turns `value`: [rx, ry, rz]."""
    sigma: Annotated[list[float], BeforeValidator(_three_sigmas)] | None = None
    """Standard deviation of the rotation after identification."""
    tolerance: Annotated[list[float], BeforeValidator(_three_sigmas)] | None = None
    """Standard deviation of the rotation from the drawing."""
    fixed: Flag | None = None
    """Whether identification must leave it as it is."""
    share: Path | None = None
    """Name of a direction that several limbs have in common."""


@dataclass(frozen=True)
class SlotGroup:
    """Slots that stand together in a file.

    Attributes:
        path: ``base.point``; of a single slot its name.
        form: what stands there. ``first axis``: that of a universal joint, which a limb may lack.
        slots: in parameter order; of directions the small rotation that is their error.
    """

    path: str
    form: Form
    slots: tuple[SlotSpec, ...]

    @property
    def parts(self) -> dict[str, SlotSpec]:
        """The slots by the last word of their names: x, y, z, rx ..."""
        return {s.name.rpartition(".")[2]: s for s in self.slots}

    @property
    def polar(self) -> dict[str, SlotSpec]:
        """What a point may have in place of x and y: radius and angle."""
        return {"radius": SlotSpec(f"{self.path}.radius", "length", "point"),
                "angle": SlotSpec(f"{self.path}.angle", "angle", "angle")}


def groups(kind: LimbKind) -> list[SlotGroup]:
    """Return the slots of a kind in order, points, directions and joint frames together."""
    out: dict[tuple[str, Form], list[SlotSpec]] = {}
    for spec in (*kind.slots, *kind.joint_slots):
        head, _, tail = spec.name.rpartition(".")
        form: Form = (
            "direction" if head in kind.directions else "first axis" if head in kind.axes else
            "joint frame" if head.startswith("joint") and tail in ("x", "y", "z", *TURNS) else
            "point" if head.endswith(POINTS) else "number")
        out.setdefault((spec.name if form == "number" else head, form), []).append(spec)
    for path in kind.axes_without_errors:
        out[path, "direction"] = []
    return [SlotGroup(path, form, tuple(slots)) for (path, form), slots in out.items()]


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
    refuse_unknown("key", raw, allowed, place)
    for key, value in raw.items():
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


def absent_axes(kind: LimbKind, given: Mapping[str, Any], at: Callable[[str], str]
                ) -> dict[str, str]:
    """Return the slots of universal joints that a limb does not have -> what it would take.

    A first axis is there where the file gives it, and its offset with it, by path
    (``base.axis_offset``); ``at``: a path -> its place in the file, for messages.

    Raises:
        BadInput: an offset without its axis, or a universal joint at both ends.
    """
    out: dict[str, str] = {}
    used = ""
    for spec in reversed(kind.axis_offsets):
        body = spec.name.partition(".")[0]
        named = next((n for n in (spec.name, spec.needs) if given.get(n) is not None), None)
        if named and used:
            raise BadInput(f"both {named} and {used} are given, but a limb has one universal "
                           "joint, and a ball at its other end", at(named), "Leave out `axis` and "
                           f"`axis_offset` under `{body}`, or under `{used.partition('.')[0]}`")
        if spec.needs and named and given.get(spec.needs) is None:
            raise BadInput(f"{spec.name} is given, but not the first axis of that joint", at(""),
                           f"Add `axis: [1, 0, 0]` under `{body}`, in {body} axes")
        if named:
            used = named
        elif spec.needs or used:
            out |= {n: spec.needs or spec.name for n in (spec.name, spec.needs) if n}
    return out
