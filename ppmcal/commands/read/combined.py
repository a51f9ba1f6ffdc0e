"""Several targets of one body as one measured pose per stand, with its covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.calibration.fit import FAILED_NOISE, LARGER, noise_state
from ppmcal.errors import BadInput
from ppmcal.io.csv import Table
from ppmcal.io.pose_fields import COORDINATES, CORRELATIONS, QUATERNION
from ppmcal.kinematics.body_pose import TOO_FEW, BodyPoses, body_poses
from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import POSE
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import FINDING, NOTE, Note
from ppmcal.units import Units
from ppmcal.wording import chance, pluralize, row_list

FLAG = "--combined"
OF_TARGET = ("x", "y", "z", "rx", "ry", "rz", *QUATERNION)
"""Columns of a target's own; with ``sigma_`` and ``u95_`` before them too."""


@dataclass(frozen=True, eq=False)
class ReadRun:
    """One measurement file, of one target where there are several.

    Attributes:
        name: of the file, without its end.
        table: in the sidecar's units (N rows).
        sidecar: what the YAML beside it says.
        data: the same, SI, without rows that cannot be used.
        stands: number of the machine's stand, from 0 on, of each of the N rows.
        target: the target's name, empty where there is one.
    """

    name: str
    table: Table
    sidecar: Mapping[str, Any]
    data: Dataset
    stands: Ints
    target: str = ""


def combined(targets: Sequence[ReadRun], machine: Mechanism, place: str
             ) -> tuple[Table, dict[str, Any], list[str], str]:
    """Return the pose at each stand, of the platform itself in the measuring frame.

    With the sidecar, findings, and what was done in a sentence.

    Args:
        targets: of one file; their points are the sidecar's, or what identification found.
        machine: that was measured.
        place: what messages call the sidecar.

    Raises:
        BadInput: a body that shows no pose by its targets, a point that nobody knows, or no stand
            at which enough of them were seen.
    """
    _refuse_what_shows_none(targets, machine, place)
    points = np.stack([_point(t, machine, place) for t in targets])
    stands = 1 + max(int(t.stands.max(initial=-1)) for t in targets)
    measured = np.full((stands, len(targets), 3), np.nan)
    noise = np.full((stands, len(targets), 3, 3), np.nan)
    for i, t in enumerate(targets):
        use = np.flatnonzero(t.data.usable)
        at = t.stands[t.data.rows[use] - 1]
        measured[at, i] = t.data.position[use]
        noise[at, i] = (np.nan_to_num(t.data.sigma_position[use])[..., None] ** 2 * np.eye(3)
                        if t.data.covariance is None else t.data.covariance[use])
    found = body_poses(points, measured, noise, machine.motion.planar)
    if all(found.reason):
        why = max(dict.fromkeys(found.reason), key=found.reason.count)
        raise BadInput(f"no row shows a pose: {why}", f"{place}: targets", "In space it takes "
                       "three targets that are not on one line, in the plane two that are apart")
    units = targets[0].data.units
    table = _conditions(targets, stands).put(_columns(found, machine, units))
    return (table, _sidecar(targets[0], found, machine),
            [*_without(found), *_misfits(targets, found)],
            f"Combined {', '.join(t.target for t in targets)}: one pose for each of "
            f"{pluralize(stands - sum(map(bool, found.reason)), 'row')} of {stands}; their "
            "points count as exact.")


def _refuse_what_shows_none(targets: Sequence[ReadRun], machine: Mechanism, place: str) -> None:
    """Refuse bodies whose targets cannot show a pose."""
    motion = machine.motion
    if not motion.turns:
        raise BadInput(f"a pose of a {motion} machine is the position of one point", FLAG,
                       "Leave it out: all targets are fitted together")
    if len(targets) < 2:
        raise BadInput("there is one target", f"{place}: targets",
                       f"Name several, or leave out {FLAG}")
    kind = targets[0].data.kind
    if kind.sees_rotation or not kind.of_poses or kind.blind:
        raise BadInput(f"positions of targets are combined, and the instrument is '{kind}'",
                       f"{place}: instrument.kind", f"Write `position`, or leave out {FLAG}")
    if targets[0].sidecar.get("read"):
        raise BadInput("rows that are shifted against the joints are not combined",
                       f"{place}: read.shift", "Put the rows right in the file")
    if targets[0].data.scale.fitted:
        raise BadInput("points of known size and a scale that is unknown contradict each other",
                       f"{place}: scale", f"Write its value, or leave out {FLAG}")


def _point(target: ReadRun, machine: Mechanism, place: str) -> Array:
    """Return where a target is on the platform, in the file's scale (3,), m.

    Raises:
        BadInput: nobody knows.
    """
    own = target.data
    if not own.target.fitted:
        return np.asarray(own.scale.value[0] * own.target.value)
    # without a name in the sidecar data sets are called by their file
    called = [own.name, f"{Path(own.source).stem} {target.target}"]
    found = next((machine.registrations[c] for c in called if c in machine.registrations), None)
    if found is None:
        known = f" (it has {', '.join(machine.registrations)})" if machine.registrations else ""
        raise BadInput(f"where the target {target.target} is on the platform is not known, and the "
                       f"mechanism file has no '{own.name}'{known}", f"{place}: "
                       f"targets.{target.target}", "Write its point [x, y, z] in platform axes, or "
                       "give what identify wrote of this file as --mechanism identified.yaml")
    return np.asarray(own.scale.value[0] * found.target)


def _conditions(targets: Sequence[ReadRun], stands: int) -> Table:
    """Return what is not of one target in each stand: of the first of its rows."""
    own = {f"{of}{c}" for of in ("", "sigma_", "u95_")
           for c in (*OF_TARGET, "position", "rotation")} | set(CORRELATIONS)
    first = targets[0].table
    kept = [h for h in first.header if h not in own]
    numbers = {h: np.full(stands, np.nan) for h in kept if h in first.numbers}
    words = {h: [""] * stands for h in kept if h in first.text}
    for t in reversed(targets):
        for h, values in numbers.items():
            values[t.stands[::-1]] = t.table.number(h)[::-1]
        for h, cells in words.items():
            for stand, cell in reversed(list(zip(t.stands.tolist(), t.table.labels(h),
                                                 strict=True))):
                cells[stand] = cell
    return Table(first.source, tuple(kept), numbers, {h: tuple(c) for h, c in words.items()},
                 stands)


def _columns(found: BodyPoses, machine: Mechanism, units: Units) -> dict[str, Array]:
    """Return poses, standard deviations and correlations by column, in the file's units."""
    parts = POSE.coordinates(machine.motion)
    factor = {i: units.factor("length" if i < 3 else "angle") for i in parts}
    sigma = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    return ({COORDINATES[i]: found.pose[:, i] / factor[i] for i in parts}
            | {f"sigma_{COORDINATES[i]}": sigma[:, i] / factor[i] for i in parts}
            | {name: found.covariance[:, i, j] / (sigma[:, i] * sigma[:, j])
               for name, (i, j) in CORRELATIONS.items() if i in parts and j in parts})


def _sidecar(target: ReadRun, found: BodyPoses, machine: Mechanism) -> dict[str, Any]:
    """Return the sidecar of the poses; noise that stands there is what rows typically have."""
    units, parts = target.data.units, POSE.coordinates(machine.motion)
    sigma = np.sqrt(np.nanmedian(np.diagonal(found.covariance, axis1=1, axis2=2), axis=0))
    own = dict(target.sidecar["instrument"]["sigma"])
    kept = {key: own[key] for key in ("actuator", "estimated") if key in own}
    typical = {what: float(f"{np.max(sigma[[i for i in parts if (i > 2) == turn]]) / factor:.3g}")
               for what, turn, factor in (("position", False, units.factor("length")),
                                          ("rotation", True, units.factor("angle")))}
    gone = ("target", "targets", "target_rotation", "read")
    return {**{k: v for k, v in target.sidecar.items() if k not in gone},
            "name": str(target.sidecar["name"]).removesuffix(f" {target.target}"),
            "instrument": {"kind": "pose", "sigma": {**typical, **kept}}, "target": "known"}


def _without(found: BodyPoses) -> list[Note]:
    """Return which rows have no pose, and why; that a target is hidden is not amiss."""
    return [Note(f"no pose in {row_list([i for i, r in enumerate(found.reason) if r == why])}: "
                 f"{why}; left empty.", NOTE if why == TOO_FEW else FINDING)
            for why in dict.fromkeys(found.reason) if why]


def _misfits(targets: Sequence[ReadRun], found: BodyPoses) -> list[Note]:
    """Return whether what the poses leave of the targets is more than their noise."""
    from scipy.stats import chi2

    if targets[0].data.estimated or not found.freedom.any():
        return []
    total, freedom = float(np.nansum(found.chi_squared)), int(found.freedom.sum())
    ratio, p = float(np.sqrt(total / freedom)), float(chi2.sf(total, freedom))
    each = chi2.sf(found.chi_squared, np.maximum(found.freedom, 1)) * max(len(found.freedom), 1)
    far = np.flatnonzero((each < FAILED_NOISE) & (found.freedom > 0))
    if noise_state(ratio, p) != LARGER and not far.size:
        return []
    some = 0 < far.size < np.count_nonzero(found.freedom)
    where = f", most of all in {row_list(far)}" if some else ""
    return [Note(f"the targets do not stand to each other as their points say: by {ratio:.3g} "
                 f"times the stated noise ({chance(p)}){where}. A target that moved, a wrong point "
                 "or a noise that is stated too small does that; covariances are by the stated "
                 "noise.")]
