"""sensitivity.json, and what is said of it and must be looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from ppmcal.design.sensitivity import Sensitivity
from ppmcal.io.results.parts import AnalysisRecord, ShownTable, geometry_note
from ppmcal.io.results.record import (
    Flag,
    PlainCell,
    Shown,
    Text,
    Whole,
    in_units,
    table_text,
)
from ppmcal.io.results.sensitivity_tables import (
    captions,
    jacobian_table,
    linearity_table,
    maps,
    pictures,
    ranking,
    ranking_table,
    rotates,
    share_table,
    shares,
    size_quantity,
    size_unit,
)
from ppmcal.io.results.tables import map_table, status_counts, unit_map
from ppmcal.io.results.units import error_words
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.region import Grid
from ppmcal.kinematics.tables import limit_reason
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import Note
from ppmcal.store.provenance import Provenance
from ppmcal.units import Angle, Key, Length, Quantity, coordinate_quantity
from ppmcal.wording import number

LINEAR_WITHIN = 0.01
"""The linear model counts as right up to this relative difference."""
BAD, FAR = 0.1, 3.0
"""A finding: the linear model is wrong by this part before this many tolerances."""
ROUND_OFF = 1e-9


def sentences(found: Sensitivity, grid: Grid | None) -> list[str]:
    """Return the results in words, the most important first."""
    return [*_home(found), *_over_poses(found, grid), *_moved_together(found), _linearity(found)]


def linear_limit(found: Sensitivity) -> float | None:
    """Return up to which size the linear model is right to 1 %, None where at all tried."""
    value = found.linear.holds_to(LINEAR_WITHIN)
    if not np.isfinite(value):
        return None
    return value / found.mechanism.units.factor(size_quantity(found))


def _home(found: Sensitivity) -> list[str]:
    """Return the errors at home, and the amplification index there."""
    units, home = found.mechanism.units, found.home
    turned = (f" and {units.words(found.home_index[1], 'angle/length')}" if rotates(found) else "")
    times = (f"{found.asked.sigmas:g} tolerances" if found.asked.sigmas != 1.0
             else "its tolerance")
    rho = units.words(found.asked.metric, "length")
    return [f"{found.mechanism.name}: {len(found.sources)} errors. At home the tool is off by "
            f"{error_words(found.mechanism, home.position[0], home.rotation[0])} (root sum "
            "square, each error one tolerance), at worst by "
            f"{error_words(found.mechanism, home.worst_position[0], home.worst_rotation[0])} with "
            f"every error at {times}.",
            f"Error amplification at home: {number(found.home_index[0], 5)} "
            f"{units.name('length/length')}{turned} (all errors alike; angles count by {rho})."]


def _over_poses(found: Sensitivity, grid: Grid | None) -> list[str]:
    """Return the range of the amplification index over the poses, and where it is least."""
    index, units = found.index[:, 0], found.mechanism.units
    good = np.isfinite(index)
    if good.sum() < 2:
        return ([f"Only 1 of {len(good)} poses can be used, see status in map.csv."]
                if 1 == good.sum() < len(good) else [])
    least = found.table.pose[int(np.nanargmin(index))]
    place = ", ".join(
        f"{name} = {number(_rounded(least[c] / units.factor(coordinate_quantity(name))))}"
        for name, c in zip(found.mechanism.coordinates, found.mechanism.dof, strict=True)
        if grid is None or c in grid.coordinates)
    return [f"Over {int(good.sum())} of {len(good)} poses it goes from "
            f"{number(np.nanmin(index))} to {number(np.nanmax(index))}; it is least at {place}."]


def _rounded(value: float) -> float:
    """Return 0 for what is only round-off."""
    return 0.0 if abs(value) < ROUND_OFF else value


def _moved_together(found: Sensitivity) -> list[str]:
    """Return what errors of the size asked for do together."""
    one, units = found.at_size, found.mechanism.units
    if one is None:
        return []
    size = one.scale[0] / units.factor(size_quantity(found))
    head = f"{len(found.moved)} errors of {size:g} {size_unit(found)} together"
    if not np.isfinite(one.exact).all():
        return [f"{head} are too large: the machine has no pose at home's joint values then."]
    linear, exact = ([units.words(v, q, 7) for v, q in zip(both[0], ("length", "angle"),
                                                           strict=True)]
                     for both in (one.linear, one.exact))
    relative = one.apart[0, 0] / one.linear[0, 0] if one.linear[0, 0] > 0.0 else None
    turned = "" if not rotates(found) else (
        f" and turn it by {linear[1]} (linear), {exact[1]} (nonlinear)")
    return [f"{head} move the tool by {linear[0]} (linear), {exact[0]} (nonlinear), apart by "
            f"{number(relative, 3)} of it{turned}."]


def _linearity(found: Sensitivity) -> str:
    """Return up to which size of errors the linear model is right."""
    limit = linear_limit(found)
    what = ("All errors tried" if not found.asked.together else " and ".join(found.asked.together))
    if limit is None:
        return f"{what}: the linear model is right to {LINEAR_WITHIN:.0%} at every size tried."
    return (f"{what}: the linear model is right to {LINEAR_WITHIN:.0%} up to {number(limit, 3)} "
            f"{size_unit(found)}.")


def findings(found: Sensitivity, mechanism: Mechanism, grid: Grid | None) -> list[Note]:
    """Return what must be looked at: poses of a file that cannot be reached, wrong linear model."""
    out = list(mechanism.findings)
    lost = [found.mechanism.names[s.parameter]
            for s, t in zip(found.sources, found.sigma, strict=True) if not t > 0.0]
    if lost:
        out.append(Note(
            f"{lost[0]}{f' and {len(lost) - 1} more' if len(lost) > 1 else ''} without a "
            "finite tolerance: root sum square, worst case and shares leave them out"))
    outside = limit_reason(mechanism, home_state(mechanism).q)
    if outside:
        out.append(Note(f"home is not within limits: {outside}"))
    if grid is None and len(found.table.status) > 1:
        out += [Note(f"row {n + 1}: {r}") for n, (s, r) in enumerate(
            zip(found.table.status, found.table.reason, strict=True)) if s != "ok"]
    limit = found.linear.holds_to(BAD)
    if not found.asked.together and limit < FAR:
        out.append(Note(
            f"the linear model is wrong by more than {BAD:.0%} from about {limit:.2g} times "
            "the tolerances on: trust Monte Carlo (ppmcal tolerances) instead"))
    return out


MOST_ENTRIES = 500_000
"""jacobian.csv is left out where it would have more rows."""


class SensitivityRecord(AnalysisRecord):
    """sensitivity.json; ``units``: of the columns of the tables, by name.

    ``tool``: in platform axes; ``amplification_position`` to ``worst_rotation``: at home;
    ``groups``: shares of the tool's variance that come from groups of errors, bare; ``linear_to``:
    size of errors up to which the linear model is right to ``linear_to_within``, None: at all
    tried. ``together``: so many errors are all off by the same ``size``, which displaces the tool
    by ``linear`` to ``exact_rotation``; ``relative``: difference of linear and exact model over the
    linear one's, bare.
    """

    FILE: ClassVar[str] = "sensitivity.json"
    FORMAT: ClassVar[str] = "ppmcal/sensitivity/1"
    TITLE: ClassVar[str] = "Sensitivity"
    TABLES: ClassVar[tuple[str, ...]] = (
        "sensitivity.csv", "map.csv", "linearity.csv", "jacobian.csv")

    errors: Whole = 0
    poses: Mapping[str, Whole] = field(default_factory=dict)
    metric: Annotated[Length[Shown | None], Key("metric.value")] = None
    metric_unit: Annotated[Text, Key("metric.unit")] = ""
    tool: Annotated[Length[tuple[Shown, ...]], Key("tool.value")] = ()
    tool_unit: Annotated[Text, Key("tool.unit")] = ""
    amplification_position: Annotated[Shown | None, Key("home.amplification_position")] = None
    amplification_rotation: Annotated[Shown | None, Quantity("angle/length"),
                                      Key("home.amplification_rotation")] = None
    rss_position: Annotated[Length[Shown | None], Key("home.rss_position")] = None
    rss_rotation: Annotated[Angle[Shown | None], Key("home.rss_rotation")] = None
    worst_position: Annotated[Length[Shown | None], Key("home.worst_position")] = None
    worst_rotation: Annotated[Angle[Shown | None], Key("home.worst_rotation")] = None
    groups: Mapping[str, tuple[Mapping[str, PlainCell], ...]] = field(default_factory=dict)
    together: Annotated[Whole | None, Key("together.errors", whole=True)] = None
    size: Annotated[Shown | None, Key("together.size")] = None
    size_unit: Annotated[Text, Key("together.size_unit")] = ""
    linear: Annotated[Length[Shown | None], Key("together.linear")] = None
    exact: Annotated[Length[Shown | None], Key("together.exact")] = None
    relative: Annotated[Shown | None, Key("together.relative")] = None
    unit: Annotated[Text, Key("together.unit")] = ""
    linear_rotation: Annotated[Angle[Shown | None], Key("together.linear_rotation")] = None
    exact_rotation: Annotated[Angle[Shown | None], Key("together.exact_rotation")] = None
    rotation_unit: Annotated[Text, Key("together.rotation_unit")] = ""
    reached: Annotated[Flag, Key("together.reached")] = False
    linear_to: Annotated[Shown | None, Key("linear_to.value")] = None
    linear_to_within: Annotated[Shown | None, Key("linear_to.relative")] = None
    linear_to_unit: Annotated[Text, Key("linear_to.unit")] = ""
    tables: tuple[ShownTable, ...] = ()
    provenance: Provenance = Provenance()
    pictures: Mapping[str, Text] | None = None

    @classmethod
    def of(cls, found: Sensitivity, mechanism: Mechanism, grid: Grid | None,
           provenance: Mapping[str, Any]) -> Self:
        """Return the record of an analysis of ``mechanism`` over a grid, or over poses."""
        units, status = found.mechanism.units, found.table.status
        amplification, home = found.home_index.tolist(), found.home
        return cls.filled(
            None, units, format=cls.FORMAT, name=found.mechanism.name,
            summary=(*sentences(found, grid), *geometry_note(mechanism)),
            units=_units(found, grid), findings=tuple(findings(found, mechanism, grid)),
            errors=len(found.sources), poses=status_counts(status),
            metric=found.asked.metric, metric_unit=units.length,
            tool=found.asked.tool, tool_unit=units.length,
            amplification_position=amplification[0], amplification_rotation=amplification[1],
            rss_position=home.position[0], rss_rotation=home.rotation[0],
            worst_position=home.worst_position[0], worst_rotation=home.worst_rotation[0],
            groups={by: tuple({"group": g, "share_position": p, "share_rotation": r}
                              for g, p, r in shares(found, by))
                    for by in ("limb", "slot", "kind", "quantity")},
            **_together(found),
            linear_to=linear_limit(found), linear_to_within=LINEAR_WITHIN,
            linear_to_unit=size_unit(found),
            tables=(share_table(found, "limb"), share_table(found, "slot"),
                    ranking_table(found)),
            provenance=provenance, pictures=captions(found, grid))

    def files(self, found: Sensitivity, grid: Grid | None, listed: bool
              ) -> dict[str, str | bytes]:
        """Return file name -> content of everything that sensitivity writes, file units.

        ``listed``: whether the poses are those of a user's file.
        """
        units = found.mechanism.units
        out: dict[str, str | bytes] = {
            "sensitivity.csv": table_text(ranking(found), units),
            "map.csv": map_table(found.mechanism, found.table.pose, maps(found, grid),
                                 found.table.status, found.table.reason),
            "linearity.csv": table_text(linearity_table(found), units)}
        if listed and len(found.table.status) * len(found.sources) <= MOST_ENTRIES:
            out["jacobian.csv"] = table_text(jacobian_table(found), units)
        return {**out, **pictures(found, grid), self.FILE: self.text()}


def _together(found: Sensitivity) -> dict[str, Any]:
    """Return the displacement at the size asked for, as fields of the record."""
    one, units = found.at_size, found.mechanism.units
    if one is None:
        return {"together": None}
    (linear, turned), (exact, exact_turn) = one.linear[0].tolist(), one.exact[0].tolist()
    return {
        "together": len(found.moved), "reached": np.isfinite(one.exact).all(),
        "size": float(one.scale[0]) / units.factor(size_quantity(found)),
        "size_unit": size_unit(found), "linear": linear, "exact": exact, "unit": units.length,
        "relative": float(one.apart[0, 0]) / linear if linear > 0.0 else None,
        "linear_rotation": turned, "exact_rotation": exact_turn, "rotation_unit": units.angle}


def _units(found: Sensitivity, grid: Grid | None) -> dict[str, str]:
    """Return the units of what the tables hold, by column."""
    units, held = found.mechanism.units, in_units(ranking(found), found.mechanism.units)
    per = {"d" + c: f"{units.length if i < 3 else units.angle} per unit of the error"
           for i, c in enumerate(POSE_COORDINATES)}
    parts = (("", units.length), ("rotation_", units.angle))
    curve = {f"{start}{what}": unit for start, unit in parts
             for what in ("linear", "exact", "difference")}
    return {**unit_map(found.mechanism, found.mechanism.coordinates), **curve,
            **{m.name: m.unit for m in maps(found, grid)},
            **{k: v for k, v in per.items() if k in held}, "rss_position": units.length,
            "rss_rotation": units.angle, "size": size_unit(found)}
