"""sensitivity.csv, sensitivity.json, map.csv, linearity.csv, jacobian.csv and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.design.error_jacobian import Poses, determinants, error_jacobian
from ppmcal.design.error_sources import Source
from ppmcal.design.sensitivity import Sensitivity
from ppmcal.io import csv_text, json_text
from ppmcal.io.results.tables import map_table
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.region import Grid
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import POSE_COORDINATES
from ppmcal.plotting.map_data import Map

MOST_ENTRIES = 500_000
"""jacobian.csv is left out where it would have more rows."""
LISTED = 15
WRONG = 0.01
"""The linear model counts as right up to this relative difference."""


def turns(found: Sensitivity) -> bool:
    """Whether the platform turns at all."""
    return found.mechanism.motion != "translational"


def parameter_unit(found: Sensitivity, source: Source) -> tuple[float, str]:
    """Return SI value and name of an error's unit."""
    p, units = found.mechanism.parameters[source.parameter], found.mechanism.units
    if p.per_unit:
        return units.factor(p.quantity), f"{units.name(p.quantity)} per unit"
    return units.factor(p.quantity), units.name(p.quantity)


def ranking(found: Sensitivity) -> dict[str, Any]:
    """Return the columns of sensitivity.csv: one row per error, the largest part first.

    ``dx ... drz``: J_g at home per unit of the error; ``position, rotation``: the same as a
    length and an angle, rms over the poses; ``rss_...``: for one standard deviation; ``share``:
    of the tool's variance.
    """
    length, angle = found.mechanism.units.factor("length"), found.mechanism.units.factor("angle")
    share = found.share()
    order = np.argsort(-share, kind="stable")
    picked = [found.sources[i] for i in order]
    unit = np.array([parameter_unit(found, s)[0] for s in picked])
    out: dict[str, Any] = {
        "rank": np.arange(1, len(picked) + 1), "name": [_name(found, s) for s in picked],
        "limb": [s.limb for s in picked], "slot": [s.group for s in picked],
        "kind": [s.kind for s in picked], "unit": [parameter_unit(found, s)[1] for s in picked],
        "tolerance": np.where(found.sigma[order] > 0.0, found.sigma[order], np.nan) / unit}
    for row, c in enumerate(POSE_COORDINATES):
        if row in found.mechanism.dof:
            out[f"d{c}"] = found.jacobian[row, order] * unit / (length if row < 3 else angle)
    position, rotation = found.over.by_position[order], found.over.by_rotation[order]
    out |= {"position": position * unit / length,
            "rss_position": position * found.sigma[order] / length, "share_position": share[order]}
    if turns(found):
        out |= {"rotation": rotation * unit / angle,
                "rss_rotation": rotation * found.sigma[order] / angle,
                "share_rotation": found.share(rotation=True)[order]}
    return out


def grouped(found: Sensitivity, by: str) -> list[tuple[str, float, float]]:
    """Return (group, share of position, share of rotation), largest first.

    ``by``: ``limb``, ``slot``, ``kind`` or ``quantity``.
    """
    def group(s: Source) -> str:
        return {"limb": s.limb, "slot": s.group, "kind": s.kind,
                "quantity": found.mechanism.parameters[s.parameter].quantity}[by]

    both = np.stack([found.share(), found.share(rotation=True)])
    names = [group(s) for s in found.sources]
    out = []
    for name in dict.fromkeys(names):
        mine = both[:, [n == name for n in names]].sum(axis=1)
        out.append((name, float(mine[0]), float(mine[1])))
    return sorted(out, key=lambda g: -g[1])


def maps(found: Sensitivity, shape: tuple[int, ...]) -> tuple[Map, ...]:
    """Return what map.csv shows of the poses, in file units."""
    units = found.mechanism.units
    length, angle = units.factor("length"), units.factor("angle")
    mm, deg, times = units.length, units.angle, found.asked.sigmas
    most = f"every error at {times:g} standard deviation{'' if times == 1.0 else 's'}"
    rows = [("amplification_position", "Error amplification, position",
             f"{mm}/{mm}", found.index[:, 0]),
            ("amplification_rotation", "Error amplification, rotation", f"{deg}/{mm}",
             found.index[:, 1] * length / angle),
            ("rss_position", "Position error from the tolerances, root sum square", mm,
             found.over.position / length),
            ("rss_rotation", "Rotation error from the tolerances, root sum square", deg,
             found.over.rotation / angle),
            ("worst_position", f"Position error, worst case, {most}", mm,
             found.over.worst_position / length),
            ("worst_rotation", f"Rotation error, worst case, {most}", deg,
             found.over.worst_rotation / angle),
            ("condition", "Smallest singular value", "", found.table.singular_value)]
    return tuple(Map(n, t, u, v.reshape(shape)) for n, t, u, v in rows
                 if turns(found) or not n.endswith("rotation"))


def linearity_table(found: Sensitivity) -> dict[str, Array]:
    """Return the columns of linearity.csv, file units."""
    units, curve = found.mechanism.units, found.linear
    length, angle = units.factor("length"), units.factor("angle")
    size = curve.scale
    if found.asked.together:
        size = size / units.factor(found.mechanism.parameters[found.moved[0]].quantity)
    out = {"size": size}
    for i, (start, factor) in enumerate((("", length), ("rotation_", angle))[:1 + turns(found)]):
        out |= {f"{start}linear": curve.linear[:, i] / factor,
                f"{start}exact": curve.exact[:, i] / factor,
                f"{start}difference": curve.apart[:, i] / factor}
    return {**out, "relative": curve.relative}


def size_unit(found: Sensitivity) -> str:
    """Return the unit of the linearity curve's sizes."""
    if not found.asked.together:
        return "times the tolerances"
    first = next(s for s in found.sources if s.parameter == found.moved[0])
    return parameter_unit(found, first)[1]


def unknown(found: Sensitivity) -> list[str]:
    """Return the errors whose tolerance is not known, and which so count for nothing."""
    return [_name(found, s) for s, t in zip(found.sources, found.sigma, strict=True)
            if not t > 0.0]


def files(found: Sensitivity, grid: Grid | None, listed: bool, said: Sequence[str],
          findings: Sequence[str], provenance: Mapping[str, Any]) -> dict[str, str | bytes]:
    """Return file name -> content of everything that sensitivity writes, file units."""
    shape = (len(found.table.status),) if grid is None else grid.shape
    shown = maps(found, shape)
    table, curve = ranking(found), linearity_table(found)
    out: dict[str, str | bytes] = {
        "sensitivity.csv": csv_text(list(table), list(table.values())),
        "map.csv": map_table(found.mechanism, found.table.pose, shown, found.table.status,
                             found.table.reason),
        "linearity.csv": csv_text(list(curve), list(curve.values()))}
    if listed and len(shape) == 1 and shape[0] * len(found.sources) <= MOST_ENTRIES:
        entries = jacobian_table(found)
        out["jacobian.csv"] = csv_text(list(entries), list(entries.values()))
    pictures = dict(_pictures(found, grid, shown, curve))
    out |= {name: content for name, (_, content) in pictures.items()}
    out["sensitivity.json"] = json_text(
        record(found, shown, table, said, findings, provenance)
        | {"pictures": {name: words for name, (words, _) in pictures.items()}})
    return out


def jacobian_table(found: Sensitivity) -> dict[str, Any]:
    """Return J_g at every pose: row of the poses, error, then ``dx ... drz``, file units."""
    good = np.array([s == "ok" for s in found.table.status])
    at = Poses(found.table.q[good], pose_motor(found.table.pose[good]), found.asked.tool)
    free = [s.parameter for s in found.sources]
    values = error_jacobian(Model(found.mechanism), at, free)
    units = found.mechanism.units
    per = np.array([parameter_unit(found, s)[0] for s in found.sources])
    out: dict[str, Any] = {"row": np.repeat(np.flatnonzero(good) + 1, len(free)),
                           "name": [_name(found, s) for s in found.sources] * int(good.sum())}
    for row, c in enumerate(POSE_COORDINATES):
        if row in found.mechanism.dof:
            factor = units.factor("length" if row < 3 else "angle")
            out[f"d{c}"] = (values[:, row] * per / factor).ravel()
    return out


def _pictures(found: Sensitivity, grid: Grid | None, shown: Sequence[Map],
              curve: Mapping[str, Array]) -> Iterator[tuple[str, tuple[str, bytes]]]:
    """Yield (file, (caption, PNG)): maps over a grid, and the linearity curve."""
    from ppmcal.plotting.curves import draw_curves
    from ppmcal.plotting.maps import draw_map

    if grid is not None:
        at = np.where(finite_rows(found.table.pose)[:, None],
                      pose_motor(np.nan_to_num(found.table.pose)), np.nan)
        side = determinants(Model(found.mechanism), found.table.q, at)
        for one in shown:
            yield f"map_{one.name}.png", (one.title, draw_map(found.mechanism, grid, one,
                                                              side.reshape(grid.shape)))
    unit = found.mechanism.units.length
    what = " and ".join(found.asked.together) or "every error at once, in the worst direction"
    yield "linearity.png", (
        "Linear against nonlinear model at home",
        draw_curves("Linear against nonlinear model at home", f"{what}, {size_unit(found)}",
                    f"displacement of the tool, {unit}",
                    [("linear", curve["size"], curve["linear"]),
                     ("nonlinear", curve["size"], curve["exact"]),
                     ("difference", curve["size"], curve["difference"])], True, True))


def record(found: Sensitivity, shown: Sequence[Map], table: Mapping[str, Any],
           said: Sequence[str], findings: Sequence[str], provenance: Mapping[str, Any]
           ) -> dict[str, Any]:
    """Return sensitivity.json without its pictures."""
    units = found.mechanism.units
    length, angle = units.factor("length"), units.factor("angle")
    per = {"d" + c: f"{units.length if i < 3 else units.angle} per unit of the error"
           for i, c in enumerate(POSE_COORDINATES)}
    columns = {**{m.name: m.unit for m in shown}, **{k: v for k, v in per.items() if k in table},
               "rss_position": units.length, "rss_rotation": units.angle,
               "size": size_unit(found)}
    groups = {by: [{"group": g, "share_position": p, "share_rotation": r}
                   for g, p, r in grouped(found, by)] for by in ("limb", "slot", "kind",
                                                                 "quantity")}
    return {
        "format": "ppmcal/sensitivity/1", "name": found.mechanism.name, "said": list(said),
        "units": columns, "findings": list(findings), "errors": len(found.sources),
        "poses": {s: found.table.status.count(s) for s in sorted(set(found.table.status))},
        "metric": {"value": found.asked.metric / length, "unit": units.length},
        "tool": {"value": list(found.asked.tool / length), "unit": units.length},
        "home": {"amplification_position": float(found.home_index[0]),
                 "amplification_rotation": float(found.home_index[1]) * length / angle,
                 "rss_position": float(found.home.position[0]) / length,
                 "rss_rotation": float(found.home.rotation[0]) / angle,
                 "worst_position": float(found.home.worst_position[0]) / length,
                 "worst_rotation": float(found.home.worst_rotation[0]) / angle},
        "groups": groups,
        "together": at_size(found),
        "linear_to": {"value": holds_to(found), "relative": WRONG, "unit": size_unit(found)},
        "tables": [group_table(found, by) for by in ("limb", "slot")] + [ranking_table(table)],
        "provenance": dict(provenance)}


def at_size(found: Sensitivity) -> dict[str, Any] | None:
    """Return the tool's displacement for errors moved together by the size asked for."""
    if found.at_size is None:
        return None
    length, angle = (found.mechanism.units.factor(q) for q in ("length", "angle"))
    one = found.at_size
    per = found.mechanism.units.factor(found.mechanism.parameters[found.moved[0]].quantity)
    return {"errors": len(found.moved), "size": float(one.scale[0]) / per,
            "size_unit": size_unit(found), "linear": float(one.linear[0, 0]) / length,
            "exact": float(one.exact[0, 0]) / length,
            "relative": (float(one.apart[0, 0] / one.linear[0, 0]) if one.linear[0, 0] > 0.0
                         else None),
            "unit": found.mechanism.units.length,
            "linear_rotation": float(one.linear[0, 1]) / angle,
            "exact_rotation": float(one.exact[0, 1]) / angle,
            "rotation_unit": found.mechanism.units.angle,
            "reached": bool(np.isfinite(one.exact).all())}


def holds_to(found: Sensitivity) -> float | None:
    """Return up to which size the linear model is right to 1 %, None where at all tried."""
    value = found.linear.holds_to(WRONG)
    if not np.isfinite(value):
        return None
    if found.asked.together:
        value /= found.mechanism.units.factor(
            found.mechanism.parameters[found.moved[0]].quantity)
    return value


def ranking_table(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the largest errors as a table for the report."""
    keep = [c for c in ("name", "tolerance", "unit", "rss_position", "share_position",
                        "rss_rotation", "share_rotation") if c in table]
    rows = [[_plain(table[c][i]) for c in keep] for i in range(min(LISTED, len(table["name"])))]
    return {"title": "Errors that count most", "columns": keep, "rows": rows,
            "note": "rss: from one standard deviation; all errors are in sensitivity.csv"}


def group_table(found: Sensitivity, by: str) -> dict[str, Any]:
    """Return shares of the tool's variance by limb or by slot."""
    both = turns(found)
    rows = [[g, p, r] if both else [g, p] for g, p, r in grouped(found, by)]
    return {"title": f"Share of the tool's variance by {by}", "rows": rows,
            "columns": [by, "position", *(["rotation"] if both else [])], "note": ""}


def _plain(value: Any) -> Any:
    return value if isinstance(value, str) else float(value) if np.isfinite(value) else None


def _name(found: Sensitivity, source: Source) -> str:
    return found.mechanism.parameters[source.parameter].name
