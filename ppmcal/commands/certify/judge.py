"""From judged rows to figures of accuracy and repeatability, uncertainty by the GUM, decision. SI.

``errors`` (N, m) are attained minus commanded coordinates, of which the first ``places`` are of
position and the others of rotation; the commanded pose is what the certified model gives at the
joint values that were commanded, where the instrument stands.

The measurand is the error of the platform's position along any one direction, so that each
contribution is that of one coordinate: of several, the root of their mean variance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit import typical_noise
from ppmcal.calibration.validation import Budget, Contribution, Figure, PlacedError
from ppmcal.commands.certify.about import GUARDED, K2, LARGEST, NONE, P95, RMS, AboutFile
from ppmcal.commands.certify.evidence import Evidence, JudgedRows, by_parameters, joint_deviations
from ppmcal.errors import BadInput
from ppmcal.io.results.knowledge import read_knowledge
from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.units import JOINT
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.repeats import repeats

TARGETS = 5
"""Positions along an axis that ISO 230-2 asks for, and poses that ISO 9283 does."""


def error_figures(position: Array, rotation: Array) -> Iterator[Figure]:
    """Yield rms, 95 % point and largest of errors (N,) each, nan where not measured."""
    for kind, values in (("position", position), ("rotation", rotation)):
        known = values[np.isfinite(values)]
        if known.size:
            yield from _sizes(kind, (float(np.sqrt(np.mean(known**2))),
                                     float(np.quantile(known, 0.95)), float(known.max())))


def _sizes(kind: str, values: Sequence[float | None], where: str = "") -> Iterator[Figure]:
    """Yield rms, 95 % point and largest error of a kind, SI, those that are known."""
    for name, value in zip((RMS, P95, LARGEST), values, strict=True):
        if value is not None:
            yield Figure("", f"{name} of {kind}", value,
                         "angle" if kind == "rotation" else "length", where=where)


def grouped(labels: Ints) -> list[Ints]:
    """Return the rows of each label (N,), labels in their order."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1) if order.size else []


# ---- ISO 9283


def one_sided(groups: Ints, directions: Array) -> list[Ints]:
    """Return the rows of each commanded pose that came from one direction, the most of each pose.

    Args:
        groups: label per commanded pose (N,).
        directions: sign of approach by joint (N, k), nan where it is not recorded.
    """
    signs = np.nan_to_num(directions).astype(int)
    out = []
    for rows in grouped(groups):
        _, which = np.unique(signs[rows], axis=0, return_inverse=True)
        which = which.reshape(-1)
        out.append(rows[which == np.argmax(np.bincount(which))])
    return out


def pose_figures(errors: Array, names: Sequence[str], places: int, sets: Sequence[Ints],
                 asked: int) -> list[Figure]:
    """Return AP and RP of ISO 9283, each of the worst pose.

    Args:
        errors: (N, m), nan where not measured.
        names: of the coordinates (m,).
        places: how many of them are of position.
        sets: rows of one commanded pose from one direction, by pose.
        asked: repeats that each pose needs.
    """
    whole: Bools = np.asarray(np.isfinite(errors).all(axis=1))
    counts = [int(whole[s].sum()) for s in sets]
    good = [s[whole[s]] for s, n in zip(sets, counts, strict=True) if n >= asked]
    symbols = [*(("AP_p", "RP_l") if places else ()),
               *(f"{a}_{n}" for n in names[places:] for a in ("AP", "RP"))]
    most, found = max(counts, default=0), [_of_pose(errors[s], names, places) for s in good]
    fewest = min(map(len, good), default=most)
    where = f"worst of {len(good)} of {len(sets)} poses" if good else ""
    why = "" if good else (
        f"at most {most} attained {'pose' if most == 1 else 'poses'} of a commanded pose from one "
        f"direction, {asked} are asked")
    return [Figure(s, _POSE[s[:2]], max((f[s] for f in found), default=None),
                   "length" if s in ("AP_p", "RP_l") else "angle", "ISO 9283", fewest, asked,
                   where, why) for s in symbols]


_POSE = {"AP": "pose accuracy", "RP": "pose repeatability"}


def _of_pose(errors: Array, names: Sequence[str], places: int) -> dict[str, float]:
    """Return AP and RP of the attained poses (n, m) of one commanded pose."""
    out = {}
    if places:
        middle = errors[:, :places].mean(axis=0)
        apart = np.linalg.norm(errors[:, :places] - middle, axis=1)
        out = {"AP_p": float(np.linalg.norm(middle)),
               "RP_l": float(apart.mean() + 3.0 * apart.std(ddof=1))}
    for i, name in enumerate(names[places:], places):
        out[f"AP_{name}"] = float(abs(errors[:, i].mean()))
        out[f"RP_{name}"] = float(3.0 * errors[:, i].std(ddof=1))
    return out


# ---- ISO 230-2


@dataclass(frozen=True, eq=False)
class AxisRows:
    """One driven axis: deviations (N,) of its joint, side of approach (N,), target label (N,)."""

    name: str
    quantity: str
    deviation: Array
    side: Array
    groups: Ints


def axis_figures(axis: AxisRows, asked: int) -> list[Figure]:
    """Return B, R, E and A of ISO 230-2 of an axis that targets were approached on both sides."""
    up, down, fewest, targets = _sides(axis, asked)
    enough = len(up) >= TARGETS
    values = bidirectional(up, down) if enough else {}
    where = f"{len(up)} of {targets} positions" if enough else axis.name
    why = "" if enough else _missing(axis, asked, len(up), fewest)
    return [Figure(s, f"{n} of {axis.name}", values.get(s), axis.quantity, "ISO 230-2", fewest,
                   asked, where, why) for s, n in _AXIS.items()]


_AXIS = {"B": "reversal", "R": "bidirectional repeatability",
         "E": "bidirectional systematic deviation", "A": "bidirectional accuracy"}


def _missing(axis: AxisRows, asked: int, targets: int, most: int) -> str:
    if not np.isfinite(axis.side).any():
        return "no direction of approach is recorded"
    if not np.isfinite(axis.deviation).any():
        return "the instrument does not tell the joint's place"
    return (f"{targets} positions with {asked} approaches from both sides, {TARGETS} are asked; "
            f"at most {most} from both")


def _sides(axis: AxisRows, asked: int) -> tuple[list[Array], list[Array], int, int]:
    """Return deviations from each side by target, fewest (else most) repeats, targets in all."""
    up, down, counts, most = [], [], [], 0
    targets = grouped(axis.groups)
    for rows in targets:
        here = axis.deviation[rows]
        one, two = (here[np.isfinite(here) & (axis.side[rows] == s)] for s in (1.0, -1.0))
        count = min(one.size, two.size)
        most = max(most, count)
        if count >= asked:
            up.append(one)
            down.append(two)
            counts.append(count)
    return up, down, min(counts, default=most), len(targets)


def bidirectional(up: Sequence[Array], down: Sequence[Array]) -> Mapping[str, float]:
    """Return B, R, E and A (ISO 230-2:2014, 3.14 to 3.23) from deviations by target position."""
    mean = np.array([[d.mean() for d in side] for side in (up, down)])
    s = np.array([[d.std(ddof=1) for d in side] for side in (up, down)])
    reversal = mean[0] - mean[1]
    repeat = np.maximum(2.0 * s.sum(axis=0) + np.abs(reversal), 4.0 * s.max(axis=0))
    return {"B": float(np.abs(reversal).max()), "R": float(repeat.max()),
            "E": float(mean.max() - mean.min()),
            "A": float((mean + 2.0 * s).max() - (mean - 2.0 * s).min())}


# ---- decision and uncertainty


TYPE_A, TYPE_B = "A", "B"
PASS, FAIL = "pass", "fail"


def decided(rule: str, value: float, limit: float | None, expanded: float
            ) -> tuple[str, float | None]:
    """Return pass or fail, and the acceptance limit; both empty without a rule.

    Guarded acceptance keeps a guard band of the expanded uncertainty below the limit.
    """
    if rule == NONE or limit is None:
        return "", None
    accepted = limit - expanded if rule == GUARDED else limit
    return PASS if value <= accepted else FAIL, accepted


SEEN = "needs measurements that no fit has seen"
UNSEEN = ("the instrument shows one length, and no attained pose",
          "joint values alone tell no attained pose")
WANTED = (("AP_p", "pose accuracy", "ISO 9283"), ("A", "bidirectional accuracy", "ISO 230-2"))
MAPPED = 2000
"""Rows of the map, evenly spread, beside the one of the largest error."""
NORMAL, KNOWN = "normal", float("inf")


def figures(evidence: Evidence, about: AboutFile) -> list[Figure]:
    """Return every figure of the certificate, those that cannot be had with the reason."""
    out = _errors(evidence)
    for rows in evidence.rows:
        if rows.data.kind.blind or rows.data.kind.scalar:
            out += [Figure(symbol, name, None, norm=norm, why=UNSEEN[rows.data.kind.blind])
                    for symbol, name, norm in WANTED]
            continue
        for one in _standards(rows, about, evidence.seen):
            out.append(replace(one, file=rows.data.name) if len(evidence.rows) > 1 else one)
    return out


def _errors(evidence: Evidence) -> list[Figure]:
    """Return the errors of all rows that no fit has seen."""
    if evidence.seen:
        units = evidence.mechanism.units
        return list(_held_out(evidence.record.residual.holdout, units.factor("length"),
                              units.factor("angle")))
    if all(r.data.kind.blind for r in evidence.rows):
        gaps = np.concatenate([np.sqrt(np.nanmean(r.errors**2, axis=1)) for r in evidence.rows])
        return [replace(f, name=f.name.replace("position", "closure"))
                for f in error_figures(gaps, np.zeros(0))]
    parts = [(r.found.position[0][r.keep], r.found.rotation[0][r.keep]) for r in evidence.rows]
    return list(error_figures(*(np.concatenate(p) for p in zip(*parts, strict=True))))


def _held_out(found: Mapping[str, ErrorSize], length: float, angle: float
              ) -> Iterator[Figure]:
    """Yield the figures on poses that identify held out; of closures where nothing else is."""
    for kind in [k for k in ("position", "rotation") if k in found] or ["closure"]:
        one = found.get(kind, ErrorSize())
        factor = angle if kind == "rotation" else length
        yield from _sizes(kind, [None if v is None else v * factor
                                 for v in (one.rms, one.p95, one.max)], "held-out poses")


def _standards(rows: JudgedRows, about: AboutFile, seen: bool) -> Iterator[Figure]:
    """Yield the figures of ISO 9283 and of ISO 230-2 of one data set."""
    sets = one_sided(rows.data.groups[rows.keep], rows.directions)
    found = pose_figures(rows.errors, rows.names, rows.places, sets, about.repeats.iso_9283)
    for one in found:
        fitted = seen and one.symbol.startswith("AP") and one.value is not None
        yield replace(one, value=None, why=SEEN) if fitted else one
    mechanism = rows.fit.problem.mechanism
    deviations, directions = joint_deviations(rows), rows.directions
    for i, name in enumerate(mechanism.actuators):
        yield from axis_figures(AxisRows(name, JOINT + name, deviations[:, i], directions[:, i],
                                         rows.data.groups[rows.keep]), about.repeats.iso_230_2)


# ---- uncertainty


def budget(evidence: Evidence, about: AboutFile, of: str) -> Budget:
    """Return the budget ``of`` a position's error along any one direction, or of a closure's."""
    lines = [_repeatability(evidence)]
    blind = all(r.data.kind.blind for r in evidence.rows)
    if not blind:
        lines += [_model(evidence), _registration(evidence)]
    if about.instrument is not None:
        factor = about.instrument.coverage_factor
        lines.append(Contribution(
            "instrument", TYPE_B, NORMAL, about.instrument.uncertainty * about.length / factor,
            KNOWN, note=f"certificate {about.instrument.certificate}, k = {factor:g}"))
    lines.append(_remainder(evidence, sum(c.part**2 for c in lines if c.source != "instrument")))
    return Budget(of, tuple(lines), about.coverage == K2)


def _repeatability(evidence: Evidence) -> Contribution:
    """Return the scatter of repeats of one pose under the same conditions, pooled."""
    sums = list[tuple[float, int]]()
    for rows in evidence.rows:
        label = repeats(rows.data)[rows.keep]
        errors = rows.errors[:, :rows.places]
        for one in grouped(label):
            mine = errors[one]
            mine = mine[np.isfinite(mine).all(axis=1)]
            if len(mine) > 1:
                sums.append((float(np.sum((mine - mine.mean(axis=0)) ** 2)),
                             (len(mine) - 1) * mine.shape[1]))
    if degrees := sum(n for _, n in sums):
        scatter = math.sqrt(sum(s for s, _ in sums) / degrees)
        return Contribution("repeatability", TYPE_A, NORMAL, scatter, float(degrees),
                            note="repeats of one pose, pooled")
    noise = evidence.record.noise
    stated = np.concatenate([_stated(r) for r in evidence.rows])
    size = float(np.sqrt(np.nanmean(stated**2)))
    return Contribution("repeatability", TYPE_A, NORMAL, size * max(noise.sigma_ratio, 1.0)
                        if np.isfinite(noise.sigma_ratio) else size, max(noise.degrees, 1.0),
                        note="no repeats: stated noise, checked by the residuals")


def _stated(rows: JudgedRows) -> Array:
    """Return the stated noise of each position coordinate (R places,), m."""
    found = rows.found.sigma[0][rows.keep][:, :rows.places].ravel()
    return found if np.isfinite(found).any() else np.array([typical_noise(rows.data)])


def _model(evidence: Evidence) -> Contribution:
    """Return what the covariance of the identified parameters does to positions.

    Raises:
        BadInput: neither measurements nor tolerances hold a parameter.
    """
    knowledge = read_knowledge(evidence.path, evidence.mechanism)
    own = [i for i, n in enumerate(knowledge.names) if n in evidence.mechanism.names]
    names = [knowledge.names[i] for i in own]
    covariance = knowledge.covariance[np.ix_(own, own)]
    open_ = [n for n, v in zip(names, np.diagonal(covariance), strict=True) if not np.isfinite(v)]
    if open_:
        raise BadInput(f"{open_[0]} is known neither by measurements nor by a tolerance, so that "
                       "no uncertainty can be stated", str(evidence.path),
                       "Run identify with tolerances as prior")
    variance = [by_parameters(r, names, covariance)[:, :r.places].mean(axis=1)
                for r in _seeing(evidence)]
    return Contribution("model parameters", TYPE_A, NORMAL, _root_mean(variance),
                        max(evidence.record.noise.degrees, 1.0),
                        note="covariance of the fit, carried to the poses")


def _seeing(evidence: Evidence) -> list[JudgedRows]:
    """Return the data sets that an instrument measured."""
    return [r for r in evidence.rows if not r.data.kind.blind]


def _registration(evidence: Evidence) -> Contribution:
    """Return what the fitted frame and target leave open of positions."""
    variance = [r.registered[r.keep][:, :r.places].mean(axis=1) for r in _seeing(evidence)]
    return Contribution("registration", TYPE_B, NORMAL, _root_mean(variance), KNOWN,
                        note="frame and target of the instrument, by its stated noise")


def _remainder(evidence: Evidence, explained: float) -> Contribution:
    """Return what the errors have beyond what the other lines explain."""
    square = float(np.mean(np.concatenate([
        np.nanmean(r.errors[:, :r.places] ** 2, axis=1) for r in evidence.rows])))
    poses = sum(int(np.unique(r.data.groups[r.keep]).size) for r in evidence.rows)
    held = evidence.record.residual.holdout.get("position")
    if evidence.seen and held is not None and held.rms is not None:
        size = held.rms * evidence.mechanism.units.factor("length")
        square = size**2 / max(r.places for r in evidence.rows)
    return Contribution("unexplained remainder", TYPE_B, NORMAL,
                        float(np.sqrt(max(square - explained, 0.0))), float(max(poses - 1, 1)),
                        note="errors beyond the lines above")


def _root_mean(variance: Sequence[Array]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(variance))))


def places(evidence: Evidence) -> list[PlacedError]:
    """Return the platform's place and the error there, row by row."""
    out = []
    for rows in evidence.rows:
        # a distance between two platform positions has two poses: the first is shown
        where = cga.translation(rows.fit.state.poses[0][rows.keep]).reshape(len(rows.errors), -1)
        size = (np.sqrt(np.nanmean(rows.errors**2, axis=1)) if rows.data.kind.blind
                else rows.found.position[0][rows.keep])
        out += [PlacedError(tuple(p[:3].tolist()), float(e))
                for p, e in zip(where, size, strict=True) if np.isfinite(e)]
    if len(out) > MAPPED:
        some = np.linspace(0, len(out) - 1, MAPPED).astype(int).tolist()
        out = [out[i] for i in sorted({*some, max(range(len(out)), key=lambda i: out[i].error)})]
    return out
