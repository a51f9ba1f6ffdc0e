"""Reading back what an identification knew: covariance and measured volume."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ppmcal.calibration.compensation import ParameterCovariance
from ppmcal.calibration.fit import DefiningParameters, Posterior, SessionKnowledge
from ppmcal.calibration.knowledge import Considered
from ppmcal.calibration.sessions import SESSION
from ppmcal.calibration.validation import DoubtfulStretch
from ppmcal.codec import in_si
from ppmcal.errors import BadInput
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import CovarianceEntry, FittedDataset
from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.units import MachineUnits, Numbers, column_factor
from ppmcal.linalg import Array, eigh
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.model.registration import Registration
from ppmcal.model.same_rows import KnownRows
from ppmcal.units import Units, coordinate_quantity

KNOWLEDGE = IdentificationRecord.FILE
"""What a fit knows of a machine, in the folder of its file."""
MODELS = ("model.yaml", "identified.yaml")
"""Files of a folder that a calibration wrote, the one with effects first."""
AGAIN = "Run identify again"
WITHOUT = "Run identify again, or remove it to go on without uncertainties"
ROUND_OFF = 1e-6
LONGEST = 1e15
"""File units: no value of a parameter and no pose is as large."""


def model_in(folder: Path) -> Path | None:
    """Return the calibrated machine's file in a folder, None where it holds none."""
    return next((p for p in (folder / m for m in MODELS) if p.is_file()), None)


def read_knowledge(path: Path, mechanism: Mechanism) -> ParameterCovariance:
    """Return the knowledge in an identification.json.

    Raises:
        BadInput: not readable, not such a file, or of another machine.
    """
    return knowledge_of(read_identification(path), mechanism, path)


def knowledge_of(record: IdentificationRecord, mechanism: Mechanism,
                 path: Path) -> ParameterCovariance:
    """Return the knowledge in what was read from ``path``.

    Raises:
        BadInput: not such a file, or of another machine.
    """
    units = _units(record, path)
    try:
        covariance = _part(record.covariance, "names", "matrix", "frames_turn_about")
        _part(record, "measured_volume", "datasets")
        names = covariance.names
        matrix = _matrix(covariance.matrix, len(names), len(names))
        _refuse_no_covariance(matrix, names, path)
        kept = _considered(covariance)
        volume = {c: _range(ends, mechanism, c) for c, ends in record.measured_volume.items()}
        turn = {n: _finite(p, 3) * units.factor("length")
                for n, p in covariance.frames_turn_about.items()}
        before = {d.name: _registration(d, units) for d in record.datasets}
        frames = {d.name: _in_si(d.frame_by, units) for d in record.datasets if d.frame_by}
    except _Incomplete as error:
        raise _no_such(path, WITHOUT) from error
    names, matrix = (*names, *kept.names), kept.beside(matrix)
    check_same_mechanism(names, mechanism, path)
    factor = np.array([column_factor(mechanism, n) for n in names])
    left = [(record.unexplained.get(kind, ErrorSize()).rms or 0.0) * units.factor(quantity)
            for kind, quantity in (("position", "length"), ("rotation", "angle"))]
    return ParameterCovariance(names, matrix * np.outer(factor, factor), volume, turn, before,
                               (left[0], left[1]),
                               tuple(_doubtful(d, mechanism, units, path) for d in record.doubtful),
                               frames)


def _considered(entry: CovarianceEntry) -> Considered:
    """Return what an identification held beside its columns (C), file units."""
    count = len(entry.names)
    if entry.held is None:
        return Considered((), np.zeros(0), np.zeros((count, 0)))
    _part(entry, "held_sigma", "held_moved")
    sigma = _finite(entry.held_sigma, len(entry.held))
    if np.any(sigma < 0.0):
        raise _Incomplete
    return Considered(entry.held, sigma, _matrix(entry.held_moved, count, len(entry.held)))


def read_basis(path: Path) -> MeasurementBasis:
    """Return the noise check of an identification.json, and how the fit ended; no ranges.

    Raises:
        BadInput: not readable, or not such a file.
    """
    record = read_identification(path)
    # the damped scheme may have ended at the noise, which is not said
    return MeasurementBasis(record.noise.sigma_ratio, record.noise.chi2_p,
                            converged=None if record.method == "damped" else record.converged)


def _doubtful(part: DoubtfulStretch, mechanism: Mechanism, units: Units, path: Path
              ) -> DoubtfulStretch:
    """Return a doubtful stretch in SI."""
    if part.actuator not in mechanism.actuators:
        raise BadInput(f"belongs to another machine: it has a joint '{part.actuator}'", str(path),
                       "Keep MODEL and its identification.json together")
    factor = mechanism.joint_units[mechanism.actuators.index(part.actuator)][0]
    low, high, position, rotation = np.nan_to_num(
        [part.low, part.high, part.position, part.rotation]).tolist()
    return DoubtfulStretch(part.actuator, factor * low, factor * high,
                           units.factor("length") * position, units.factor("angle") * rotation)


def read_posterior(path: Path, mechanism: Mechanism) -> Posterior:
    """Return what an identification.json knows of a machine's parameters.

    Raises:
        BadInput: not readable, not such a file, of another machine, or of an old version.
    """
    record = read_identification(path, AGAIN)
    units = _units(record, path)
    try:
        covariance = _part(record.covariance, "names", "prior", "inflation")
        names = [n for n in covariance.names if " of " not in n]
        matrix, right, tolerance, scale, inflation = _information(covariance, len(names))
        value = _values(record, names)
        inputs = tables_of(record)
        session = _session(covariance.session, mechanism, names)
        defining = _defining(covariance.defining, mechanism, names)
        rows = known_in(record, mechanism)
    except _Incomplete as error:
        raise _no_such(path, AGAIN) from error
    check_same_mechanism(names, mechanism, path)
    if units != mechanism.units:
        raise BadInput(f"is in {units.length} and {units.angle}, the machine in "
                       f"{mechanism.units.length} and {mechanism.units.angle}", str(path),
                       "Use the machine file that it was made with")
    factor = np.array([column_factor(mechanism, n) for n in names])
    return Posterior(tuple(mechanism.names.index(n) for n in names), value * factor,
                     matrix / factor, right, tolerance * factor, scale * factor, inflation,
                     inputs, str(path), session, rows, defining=defining)


def check_data_not_reused(before: Posterior, source: Mapping[str, Any]) -> None:
    """Refuse to count measurements that an earlier calibration holds already.

    Raises:
        BadInput: a table in the provenance ``source`` is behind ``before``.
    """
    for name, digest in source["inputs"].items():
        if digest in before.inputs:
            raise BadInput(f"is in that calibration already, as {before.inputs[digest]}", name,
                           "Give new measurements only, or leave out --keep")


def check_same_mechanism(names: Sequence[str], mechanism: Mechanism, path: Path) -> None:
    """Refuse a file whose parameters the machine does not have.

    Raises:
        BadInput: it belongs to another machine.
    """
    strangers = [n for n in names if " of " not in n and n not in mechanism.names]
    if strangers:
        raise BadInput(f"belongs to another machine: it has a parameter '{strangers[0]}'",
                       str(path), "Keep MODEL and its identification.json together")


def read_identification(path: Path, hint: str = WITHOUT) -> IdentificationRecord:
    """Return what an identification.json holds.

    Raises:
        BadInput: not readable, or not such a file of this version.
    """
    record = IdentificationRecord.read(path, hint)
    if record.format != IdentificationRecord.FORMAT:
        raise _no_such(path, hint)
    return record


def _no_such(path: Path, hint: str) -> BadInput:
    return BadInput("is not an identification.json of this version of ppmcal", str(path), hint)


def _units(record: IdentificationRecord, path: Path) -> Units:
    try:
        return Units(record.units.length, record.units.angle)
    except BadInput as error:
        raise error.at(str(path)) from None


class _Incomplete(ValueError):
    """A part of the file that is needed is missing, or of another size."""


T = TypeVar("T")


def _part(part: T | None, *names: str) -> T:
    """Return a part that must have these keys."""
    given = getattr(part, "given", names)    # what was not read has all
    if part is None or any(n not in given or getattr(part, n) is None for n in names):
        raise _Incomplete
    return part


def _numbers(values: Numbers, size: int) -> Array:
    """Return so many numbers (size,), nan for null."""
    if len(values) != size:
        raise _Incomplete
    return np.array(values, dtype=float)


def _finite(values: Numbers, size: int) -> Array:
    """Return so many numbers (size,), without null among them."""
    found = _numbers(values, size)
    if np.isnan(found).any():
        raise _Incomplete
    return found


def _matrix(rows: Sequence[Numbers], height: int, width: int) -> Array:
    """Return a matrix (height, width), nan for null."""
    if len(rows) != height:
        raise _Incomplete
    return np.array([_numbers(r, width) for r in rows], dtype=float).reshape(height, width)


def _refuse_no_covariance(matrix: Array, names: Sequence[str], path: Path) -> None:
    """Refuse a matrix (c, c) that is the covariance of nothing; null for what is not known.

    Raises:
        BadInput: a variance below 0, correlations beyond 1 or not alike on both sides.
    """
    def refusal(what: str, column: int) -> BadInput:
        return BadInput(what, f"{path}: covariance.matrix, {names[column]}", WITHOUT)

    known = np.flatnonzero(np.isfinite(np.diagonal(matrix)))
    variance = np.diagonal(matrix)[known]
    block = matrix[np.ix_(known, known)]
    if np.any(variance < 0.0):
        raise refusal(f"{variance.min():g} is not a variance", int(known[np.argmin(variance)]))
    sigma = np.sqrt(variance)
    scale = np.outer(sigma, sigma)
    # where sigma is 0 so is the covariance; else it is a correlation times both
    bad = ~(np.abs(block) <= scale * (1.0 + ROUND_OFF)) | ~(
        np.abs(block - block.T) <= ROUND_OFF * scale)
    if bad.any():
        raise refusal("the entries are not those of a covariance",
                      int(known[np.argwhere(bad)[0, 0]]))
    free = sigma > 0.0
    if free.any():
        size = sigma[free]
        lowest, way = eigh(block[np.ix_(free, free)] / size / size[:, None])
        if lowest[0] < -ROUND_OFF * len(lowest):
            strongest = int(np.argmax(np.abs(way[:, 0])))
            raise refusal("the entries together are not a covariance",
                          int(known[np.flatnonzero(free)[strongest]]))


def _range(ends: Numbers, mechanism: Mechanism, coordinate: str) -> tuple[float, float]:
    """Return the ends of a measured range, SI."""
    low, high = _finite(ends, 2).tolist()
    if coordinate not in POSE_COORDINATES or not -LONGEST < low <= high < LONGEST:
        raise _Incomplete
    f = mechanism.units.factor(coordinate_quantity(coordinate))
    return low * f, high * f


def _registration(data: FittedDataset, units: Units) -> Registration:
    """Return where the instrument stood if the nominal geometry is believed."""
    entry = _part(data, "name").registration_before
    found = None if entry is None else entry.in_si(units)
    if found is None:
        raise _Incomplete
    return found


def _in_si(found: T, units: Units) -> T:
    """Return a finding of the file, SI."""
    try:
        return in_si(found, units)
    except ValueError as error:
        raise _Incomplete from error


def _information(entry: CovarianceEntry, count: int) -> tuple[Array, Array, Array, Array, float]:
    """Return rows |matrix s - right|^2 of steps s (k, F), (k,), tolerance, scale (F,), inflation.

    What the data alone say, file units, and the prior.
    """
    _part(entry, "data_matrix", "data_right", "unit_of_parameters")
    right = _finite(entry.data_right, len(entry.data_right))
    matrix = _matrix(entry.data_matrix, right.size, count)
    scale = _finite(entry.unit_of_parameters, count)
    tolerance = _numbers(entry.prior[:count], count)
    tolerance[np.isnan(tolerance)] = np.inf
    inflation = entry.inflation or 0.0
    if np.isnan(matrix).any() or not (np.all(tolerance > 0.0) and np.all(scale > 0.0)
                                      and inflation >= 1.0):
        raise _Incomplete
    return matrix, right, tolerance, scale, inflation


def _session(entry: SessionKnowledge | None, mechanism: Mechanism, parameters: Sequence[str]
             ) -> SessionKnowledge | None:
    """Return what the data say beyond the parameters, SI; None in files of older versions."""
    if entry is None:
        return None
    _part(entry, "names", "matrix", "right", "scale", "noise", "spread", "degrees")
    known = [f"homing.{a} of {SESSION}" for a in mechanism.actuators]
    if any(n.startswith("homing.") and n not in known for n in entry.names):
        raise _Incomplete
    found = _in_si(entry, MachineUnits.of(mechanism, parameters))
    if not (found.matrix.shape == (found.right.size, len(parameters) + len(found.names))
            and np.isfinite(found.matrix).all() and np.isfinite(found.right).all()
            and np.all(found.scale > 0.0) and found.noise >= 0.0 and found.spread >= 0.0
            and math.isfinite(found.degrees)
            and all(len(s.q) == len(s.rest) and np.isfinite(s.rest).all() for s in found.sights)):
        raise _Incomplete
    return found


def _defining(entry: DefiningParameters | None, mechanism: Mechanism, parameters: Sequence[str]
              ) -> DefiningParameters | None:
    """Return what defined the frames, SI; None in files of older versions, too."""
    if entry is None:
        return None
    _part(entry, "names", "scale", "seen")
    if not set(entry.names) <= set(mechanism.names) - set(parameters):
        raise _Incomplete
    found = _in_si(entry, MachineUnits.of(mechanism, parameters))
    if not (found.seen.shape == (len(found.names), len(parameters))
            and np.isfinite(found.seen).all() and np.all(found.scale > 0.0)
            and len(set(found.names)) == found.scale.size == len(found.names)):
        raise _Incomplete
    return found


def _values(record: IdentificationRecord, names: Sequence[str]) -> Array:
    """Return the values of parameters (F,), file units."""
    found = {p.name: p.value for p in _part(record, "parameters").parameters}
    value = _finite(tuple(found.get(n) for n in names), len(names))
    if len(set(names)) != len(names) or np.any(np.abs(value) >= LONGEST):
        raise _Incomplete
    return value


def known_in(record: IdentificationRecord, mechanism: Mechanism) -> tuple[KnownRows, ...]:
    """Return rows of the tables behind a calibration, SI; none in files of older versions.

    Raises:
        ValueError: they are not numbers.
    """
    try:
        return tuple(r.known(mechanism) for r in record.known_rows)
    except ValueError as error:
        raise _Incomplete from error


def tables_of(record: IdentificationRecord) -> dict[str, str]:
    """Return content hash -> name of the tables behind a calibration; none of those in memory.

    Raises:
        ValueError: the file does not say.
    """
    sums = _part(record.provenance, "inputs").inputs
    sources = [_part(d, "source").source for d in _part(record, "datasets").datasets]
    return {sums[s]: s for s in sources if s in sums} | dict(record.earlier)
