"""Tables and maps of ``stiffness``: how far the tool gives way, and what gives way."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from ppmcal.calibration.fit import GAP, gap_names
from ppmcal.design.stiffness import Home, Stiffnesses
from ppmcal.io.results.parts import ShownTable
from ppmcal.io.results.record import Part, Shown, Text
from ppmcal.kinematics.region import Grid, Map
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
FORCE = "force_"
"""How columns of what limbs hold begin."""
WIDE = 30.0
"""Colours go with the logarithm where values differ by more than this factor."""


class AppliedLoad(Part):
    """The load at the tool point in base axes, N and N m, and in words."""

    words: Text = ""
    fx: Shown | None = None
    fy: Shown | None = None
    fz: Shown | None = None
    mx: Shown | None = None
    my: Shown | None = None
    mz: Shown | None = None

    @classmethod
    def of(cls, wrench: Array, words: str) -> Self:
        """Return the load of a wrench (6,)."""
        return cls(words=words, **dict(zip(WRENCH, wrench.tolist(), strict=True)))

    @property
    def wrench(self) -> Array:
        """Force and moment (6,)."""
        return np.array([getattr(self, c) for c in WRENCH], dtype=float)


@dataclass(frozen=True, eq=False)
class StiffnessStudy:
    """What was asked, and what was found.

    Attributes:
        mechanism: as read.
        wanted: poses (N, 6), nan where open; ``grid``: where they are one.
        tool: tool point in platform axes (3,), m.
        load: None without one.
        home: compliance at home; ``found``: over the poses.
        notes: what the command has to say itself.
        tension: of ropes without the load, their mean, N.
    """

    mechanism: Mechanism
    wanted: Array
    grid: Grid | None
    tool: Array
    load: AppliedLoad | None
    home: Home
    found: Stiffnesses
    notes: tuple[str, ...] = ()
    tension: float = 0.0

    @property
    def conditions(self) -> tuple[str, ...]:
        """Limbs as forces are told of them (m,), those with several conditions numbered."""
        return tuple(name.removeprefix(GAP) for name in gap_names(self.mechanism))


def maps(study: StiffnessStudy) -> list[Map]:
    """Return what the table holds, in the grid's shape, or one row per pose."""
    units, found = study.mechanism.units, study.found
    shape = study.grid.shape if study.grid else (len(found.determinant),)

    def one(name: str, title: str, quantity: str, values: Array) -> Map:
        shown = Map.of(units, name, title, quantity, values.reshape(shape))
        finite = shown.values[np.isfinite(shown.values) & (shown.values > 0.0)]
        wide = bool(finite.size) and bool(finite.max() > WIDE * finite.min())
        return replace(shown, log=wide)

    soft, stiff = found.translational.T
    out = [one("stiffness_min", "Translational stiffness, softest direction", "N/length", soft),
           one("stiffness_max", "Translational stiffness, stiffest direction", "N/length", stiff)]
    turns = [c for c in study.mechanism.dof if c >= 3]
    if turns:
        soft, stiff = found.rotational.T
        out += [one("rotational_min", "Rotational stiffness, softest axis", "N.m/angle", soft),
                one("rotational_max", "Rotational stiffness, stiffest axis", "N.m/angle", stiff)]
    if found.deflection is not None and study.load is not None:
        size = [np.linalg.norm(found.deflection[:, part], axis=1)
                for part in (slice(0, 3), slice(3, 6))]
        under = f"of the tool under {study.load.words}"
        out.append(one("deflection_position", f"Displacement {under}", "length", size[0]))
        if turns:
            out.append(one("deflection_rotation", f"Rotation {under}", "angle", size[1]))
    return [*out, *_force_maps(study, shape)]


def _force_maps(study: StiffnessStudy, shape: tuple[int, ...]) -> list[Map]:
    """Return what each limb holds, positive where it pulls."""
    held = study.found.held
    if held is None or held.forces is None:
        return []
    units = [unit for limb in study.mechanism.limbs for unit in (
        "N m" if turns else "N" for turns in limb.kind.surface.of_angles)]
    return [Map(f"{FORCE}{name}", f"Force in {name}, positive where it pulls", unit,
                values.reshape(shape)) for name, unit, values in zip(
                    study.conditions, units, held.forces.T, strict=True)]


def force_table(study: StiffnessStudy) -> ShownTable:
    """Return what surplus limbs hold at home, without a load and under it."""
    held = study.home.held
    columns = {} if held is None else {
        name: force[0] for name, force in (("without load", held.idle), ("under load", held.loaded))
        if force is not None and np.isfinite(force).all()}
    rows = tuple((name, *(f"{force[i]:.4g}" for force in columns.values()))
                 for i, name in enumerate(study.conditions)) if columns else ()
    return ShownTable(title="What limbs hold at home, N", columns=("limb", *columns), rows=rows,
                      note="Positive where they pull.")


def share_table(study: StiffnessStudy) -> ShownTable:
    """Return which part gives way most at home: limb by limb, and part by part, in percent."""
    found = study.home.compliance
    wrench, what = divided_load(study)
    share = 100.0 * found.shares(wrench)[0]
    owners = list(dict.fromkeys(s.owner for s in found.springs))
    parts = sorted({s.part.partition(".")[0] for s in found.springs},
                   key=lambda p: (p.startswith("joint"), p))
    sums = {(o, p): [float(v) for v, s in zip(share, found.springs, strict=True)
                     if s.owner == o and s.part.partition(".")[0] == p]
            for o in owners for p in parts}

    def cell(chosen: list[str], part: list[str]) -> str:
        values = [v for o in chosen for p in part for v in sums[o, p]]
        return f"{sum(values):.1f}" if values else "-"

    named = [*((o, [o]) for o in owners), ("all", owners)]
    rows = tuple((name, *(cell(own, [p]) for p in parts), cell(own, parts)) for name, own in named)
    if not np.isfinite(share).all():
        rows = ()
    return ShownTable(title="What gives way at home, percent", columns=("limb", *parts, "all"),
                      rows=rows, note=f"Shares of the deflection along {what}: of twice the "
                      "energy in the springs.")


def divided_load(study: StiffnessStudy) -> tuple[Array, str]:
    """Return the load whose deflection is divided up (6,), and its name."""
    if study.load is not None:
        return study.load.wrench, study.load.words
    found = study.home.compliance
    out = np.zeros(6)
    move = [c for c in study.mechanism.dof if c < 3]
    soft = found.translational()
    if np.isfinite(soft.values[0, 0]):
        out[move] = soft.directions[0, :, 0]
        return out, "a force in the softest direction"
    turn = [c for c in study.mechanism.dof if c >= 3]
    soft = found.rotational()
    if turn:
        out[turn] = soft.directions[0, :, 0]
    return out, "a moment about the softest axis"


def principal_table(study: StiffnessStudy) -> ShownTable:
    """Return the principal stiffnesses at home with their directions."""
    mechanism, found = study.mechanism, study.home.compliance
    rows = []
    for word, principal, quantity in (("translation", found.translational(), "N/length"),
                                      ("rotation", found.rotational(), "N.m/angle")):
        axes = [c % 3 for c in mechanism.dof if (c < 3) == (word == "translation")]
        for k, value in enumerate(principal.values[0] / mechanism.units.factor(quantity)):
            way = np.zeros(3)
            way[axes] = principal.directions[0, :, k]
            text = "rigid" if np.isinf(value) else f"{value:.5g}"
            rows.append((word, text, mechanism.units.name(quantity),
                         *(f"{v + 0.0:.3f}" for v in np.round(way, 3))))
    return ShownTable(
        title="Principal stiffness at home", rows=tuple(rows),
        columns=("motion", "stiffness", "unit", "along x", "along y", "along z"),
        note="Inverses of the translational and the rotational block of the compliance, "
        "from soft to stiff; directions and axes in base axes.")
