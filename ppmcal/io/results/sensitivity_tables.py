"""Tables and pictures of ``sensitivity``: sensitivity.csv, map.csv, linearity.csv, jacobian.csv."""

from __future__ import annotations

from functools import partial

import numpy as np

from ppmcal.calibration.fit import pictures_beside
from ppmcal.design.error_jacobian import Poses, determinants, error_jacobian
from ppmcal.design.sensitivity import Sensitivity
from ppmcal.io.results.parts import ShownTable
from ppmcal.io.results.record import Column, in_units
from ppmcal.io.results.tables import error_columns, error_unit, map_pictures
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.region import Grid, Map
from ppmcal.linalg import finite_rows
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.units import coordinate_quantity

LISTED = 15
LINEARITY = "Linear against nonlinear model at home"

EQUAL = 9
"""Digits of a share that count: equal legs stay in the file's order on any processor."""


def rotates(found: Sensitivity) -> bool:
    """Whether the platform rotates at all."""
    return found.mechanism.motion.turns


def ranking(found: Sensitivity) -> list[Column]:
    """Return the columns of sensitivity.csv: one row per error, the largest part first.

    ``dx ... drz``: J_g at home per unit of the error; ``position, rotation``: the same as a
    length and an angle, rms over the poses; ``rss_...``: for one standard deviation; ``share``:
    of the tool's variance.
    """
    share = found.share()
    order = np.argsort(-np.round(share, EQUAL), kind="stable")
    named, unit = error_columns(found.mechanism, [found.sources[i] for i in order], "kind")
    sigma = found.sigma[order]
    out = [Column("rank", np.arange(1, len(order) + 1)), *named,
           Column("tolerance", np.where(sigma > 0.0, sigma, np.nan) / unit)]
    out += [Column(f"d{c}", found.jacobian[row, order] * unit, coordinate_quantity(c))
            for row, c in enumerate(POSE_COORDINATES) if row in found.mechanism.dof]
    parts = [("position", "length", found.over.by_position[order], share[order])]
    if rotates(found):
        parts.append(("rotation", "angle", found.over.by_rotation[order],
                      found.share(rotation=True)[order]))
    for part, quantity, size, own in parts:
        out += [Column(part, size * unit, quantity),
                Column(f"rss_{part}", size * sigma, quantity), Column(f"share_{part}", own)]
    return out


def shares(found: Sensitivity, by: str) -> list[tuple[str, float, float]]:
    """Return (group, share of position, share of rotation), largest first.

    ``by``: ``limb``, ``slot``, ``kind`` or ``quantity``.
    """
    both = np.stack([found.share(), found.share(rotation=True)])
    names = [{"limb": s.limb, "slot": s.group, "kind": s.kind,
              "quantity": found.mechanism.parameters[s.parameter].quantity}[by]
             for s in found.sources]
    out = []
    for name in dict.fromkeys(names):
        mine = both[:, [n == name for n in names]].sum(axis=1)
        out.append((name, float(mine[0]), float(mine[1])))
    return sorted(out, key=lambda g: -round(g[1], EQUAL))


def maps(found: Sensitivity, grid: Grid | None) -> list[Map]:
    """Return what map.csv shows of the poses, in the grid's shape or one row per pose."""
    times = found.asked.sigmas
    most = f"every error at {times:g} standard deviation{'' if times == 1.0 else 's'}"
    rows = [("amplification_position", "Error amplification, position", "length/length",
             found.index[:, 0]),
            ("amplification_rotation", "Error amplification, rotation", "angle/length",
             found.index[:, 1]),
            ("rss_position", "Position error from the tolerances, root sum square", "length",
             found.over.position),
            ("rss_rotation", "Rotation error from the tolerances, root sum square", "angle",
             found.over.rotation),
            ("worst_position", f"Position error, worst case, {most}", "length",
             found.over.worst_position),
            ("worst_rotation", f"Rotation error, worst case, {most}", "angle",
             found.over.worst_rotation),
            ("condition", "Smallest singular value", "1", found.table.singular_value)]
    shape = (len(found.table.status),) if grid is None else grid.shape
    return [Map.of(found.mechanism.units, name, title, quantity, values.reshape(shape))
            for name, title, quantity, values in rows
            if rotates(found) or not name.endswith("rotation")]


def size_quantity(found: Sensitivity) -> str:
    """Return what the linearity curve's sizes are: of the parameters moved, or bare multiples."""
    if not found.asked.together:
        return ""
    return found.mechanism.parameters[found.moved[0]].quantity


def size_unit(found: Sensitivity) -> str:
    """Return the unit of the linearity curve's sizes."""
    if not found.asked.together:
        return "times the tolerances"
    return error_unit(found.mechanism, found.moved[0])


def linearity_table(found: Sensitivity) -> list[Column]:
    """Return the columns of linearity.csv."""
    curve = found.linear
    out = [Column("size", curve.scale, size_quantity(found))]
    parts = (("", "length"), ("rotation_", "angle"))
    for i, (start, quantity) in enumerate(parts[:1 + rotates(found)]):
        out += [Column(f"{start}linear", curve.linear[:, i], quantity),
                Column(f"{start}exact", curve.exact[:, i], quantity),
                Column(f"{start}difference", curve.apart[:, i], quantity)]
    return [*out, Column("relative", curve.relative)]


def jacobian_table(found: Sensitivity) -> list[Column]:
    """Return J_g at every pose: row of the poses, error, then ``dx ... drz``."""
    good = np.array([s == "ok" for s in found.table.status])
    at = Poses(found.table.q[good], pose_motor(found.table.pose[good]), found.asked.tool)
    free = [s.parameter for s in found.sources]
    values = error_jacobian(Model(found.mechanism), at, free)
    (name, *_), per = error_columns(found.mechanism, found.sources, "kind")
    out = [Column("row", np.repeat(np.flatnonzero(good) + 1, len(free))),
           Column("name", name.values * int(good.sum()))]
    return out + [Column(f"d{c}", (values[:, row] * per).ravel(), coordinate_quantity(c))
                  for row, c in enumerate(POSE_COORDINATES) if row in found.mechanism.dof]


def pictures(found: Sensitivity, grid: Grid | None) -> dict[str, bytes]:
    """Return file -> PNG: maps over a grid, and the linearity curve."""
    from ppmcal.plotting.curves import draw_curves

    drawn: dict[str, bytes] = {}
    if grid is not None:
        at = np.where(finite_rows(found.table.pose)[:, None],
                      pose_motor(np.nan_to_num(found.table.pose)), np.nan)
        drawn = map_pictures(found.mechanism, grid, maps(found, grid), determinants(
            Model(found.mechanism), found.table.q, at))
    units = found.mechanism.units
    curve = in_units(linearity_table(found), units)
    what = " and ".join(found.asked.together) or "every error at once, in the worst direction"
    return drawn | pictures_beside({"linearity.png": partial(
        draw_curves, LINEARITY, f"{what}, {size_unit(found)}",
        f"displacement of the tool, {units.length}",
        [("linear", curve["size"], curve["linear"]),
         ("nonlinear", curve["size"], curve["exact"]),
         ("difference", curve["size"], curve["difference"])], True, True)})


def captions(found: Sensitivity, grid: Grid | None) -> dict[str, str]:
    """Return what each picture shows, by file."""
    out = {} if grid is None else {f"map_{m.name}.png": m.title for m in maps(found, grid)}
    return {**out, "linearity.png": LINEARITY}


def ranking_table(found: Sensitivity) -> ShownTable:
    """Return the largest errors as a table for the report."""
    table = in_units(ranking(found), found.mechanism.units)
    keep = [c for c in ("name", "tolerance", "unit", "rss_position", "share_position",
                        "rss_rotation", "share_rotation") if c in table]
    rows = zip(*(table[c][:LISTED] for c in keep), strict=True)
    return ShownTable(title="Errors that count most", columns=tuple(keep), rows=tuple(rows),
                      note="rss: from one standard deviation; all errors are in sensitivity.csv")


def share_table(found: Sensitivity, by: str) -> ShownTable:
    """Return shares of the tool's variance by limb or by slot."""
    both = rotates(found)
    return ShownTable(title=f"Share of the tool's variance by {by}", note="",
                      rows=tuple(row[:2 + both] for row in shares(found, by)),
                      columns=(by, "position", *(["rotation"] if both else [])))
