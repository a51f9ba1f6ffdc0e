"""What a certificate stands on: results made again, and rows that are judged by the model."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ppmcal.calibration.fit import (
    LARGER,
    Fit,
    FitOptions,
    Problem,
    coordinates,
    identify,
    is_open,
    labels,
    opened,
    prediction_covariance,
)
from ppmcal.calibration.validation import Residuals, residuals, validated, with_and_without
from ppmcal.commands.inputs import data_files, load, prepared
from ppmcal.commands.validate.run import to_register
from ppmcal.commands.verify.options import VerifyArguments
from ppmcal.commands.verify.run import run as made_again
from ppmcal.errors import BadInput
from ppmcal.io.results.beside_model import seen_before
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.knowledge import read_identification
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import environment_of, shifted
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.registration import carried_back
from ppmcal.linalg import Array, Bools, finite_rows, inv, pinv
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import REGISTERED
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.folder import RECORD
from ppmcal.store.inputs import digest_of, track_input
from ppmcal.store.runs import RecordedRun, runs_of
from ppmcal.wording.progress import start_stage

CALIBRATIONS, VALIDATE = ("identify", "diagnose"), "validate"
SPREAD = 5000
"""Rows by which the uncertainty of a model is judged."""
UNCERTAIN = ("partial", "unnamed", "misread")
"""Verdicts of a diagnosis after which nobody knows what the model lacks."""


@dataclass(frozen=True, eq=False)
class JudgedRows:
    """One data set against the model as it is, only the registration fitted, SI.

    ``found``: errors row by row; ``keep`` (N,): rows that count; ``names``, ``places``: of the
    measured coordinates, and how many of them are of position; ``registered`` (N, m): variance of
    each by the registration; ``left_out``: rows of the CSV that count nowhere.
    """

    data: Dataset
    fit: Fit
    found: Residuals
    keep: Bools
    names: tuple[str, ...]
    places: int
    registered: Array
    left_out: tuple[int, ...] = ()

    @property
    def errors(self) -> Array:
        """Errors of the rows that count (R, m)."""
        return np.asarray(self.found.vector[0][self.keep])

    @property
    def directions(self) -> Array:
        """Side of approach of each joint (R, k), nan where it is not recorded."""
        environment = environment_of(self.fit.problem.mechanism, self.data)
        return np.asarray(environment.approach[self.keep])


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is certified, and by what; ``seen``: the rows are those of the calibration itself.

    ``inputs``: path -> SHA-256 of what came out again or went into it, empty where only this reads.
    """

    mechanism: Mechanism
    record: IdentificationRecord
    path: Path
    rows: tuple[JudgedRows, ...]
    seen: bool
    inputs: Mapping[str, str]


def gathered(folder: Path, validation: Sequence[str | os.PathLike[str]]) -> Evidence:
    """Return what the certificate stands on, made again and found fit for it.

    Raises:
        BadInput: results that do not come out as they are, or cannot be certified.
    """
    run = _calibration_run(folder)
    record = read_identification(folder / IdentificationRecord.FILE)
    tests = [_validation_run(Path(p), folder) for p in validation if Path(p).is_dir()]
    files = [os.fspath(p) for p in validation if not Path(p).is_dir()]
    refuse_uncertifiable(record, folder, bool(validation))
    inputs = _verified([run, *tests])
    for test in tests:
        files += [p for p in _data_of(test) if p not in files]
    seen = not files
    start_stage("judging the rows")
    mechanism, datasets = prepared(load(folder), _data_of(run) if seen else files, "none")
    inputs = dict.fromkeys(data_files(datasets), "") | inputs
    if not seen:
        _refuse_seen(folder, mechanism, datasets)
    words = next((w for t in tests if (w := t.source.options.get("register"))), None)
    rows = tuple(judged(mechanism, d, words) for d in datasets)
    return Evidence(mechanism, record, folder / IdentificationRecord.FILE, rows, seen, inputs)


def _calibration_run(folder: Path) -> RecordedRun:
    """Return the run that calibrated a machine into a folder."""
    if not folder.is_dir():
        raise BadInput("is not a folder", str(folder),
                       "Give the folder that identify or diagnose wrote")
    found = [r for r in runs_of(folder) if r.command in CALIBRATIONS]
    if not found:
        raise BadInput("holds no calibration that ppmcal has recorded", str(folder),
                       "Give the folder that identify or diagnose wrote")
    return found[-1]


def _validation_run(folder: Path, model: Path) -> RecordedRun:
    """Return the run that validated the calibration in ``model``."""
    found = [r for r in runs_of(folder) if r.command == VALIDATE]
    if not found:
        raise BadInput("holds no validation that ppmcal has recorded", str(folder),
                       "Give a folder that validate wrote, or measurement files")
    sums = {digest_of(model / n) for n in ("identified.yaml", "model.yaml")} - {""}
    if not sums & set(found[-1].source.inputs.values()):
        raise BadInput(f"is of another model than {model} holds", str(folder),
                       f"Run `ppmcal validate {model} DATA` again, and give that folder")
    return found[-1]


def refuse_uncertifiable(record: IdentificationRecord, folder: Path, validation: bool) -> None:
    """Refuse a calibration that says itself that its figures cannot be relied on.

    Raises:
        BadInput: not converged, residuals beyond the noise, nothing that no fit has seen.
    """
    place = str(folder / IdentificationRecord.FILE)
    if record.converged is False and record.method != "damped":
        raise BadInput("the fit had not converged, and cannot be certified", place,
                       "Run identify with more --iterations")
    if record.noise.state == LARGER:
        raise BadInput(f"residuals are {record.noise.sigma_ratio:.3g} times the noise, which "
                       "cannot explain them, so that the model cannot be certified", place,
                       "Run `ppmcal diagnose` to find what the model lacks, or identify with "
                       "--sigma estimated where the stated noise was too small")
    if not validation and not record.residual.holdout:
        raise BadInput("no poses were held out, and no other measurements are given", place,
                       "Give measurements that no fit has seen, or run identify with --holdout 0.2")


def refuse_unknown_cause(verdict: str, place: str) -> None:
    """Refuse a diagnosis that could not say what the model lacks.

    Raises:
        BadInput: with its verdict.
    """
    if verdict in UNCERTAIN:
        raise BadInput(f"the diagnosis ended with the verdict {verdict}: what the model lacks is "
                       "not known, so that it cannot be certified", place,
                       "Take the measurements that it asks for, and diagnose again")


def _verified(runs: Iterable[RecordedRun]) -> dict[str, str]:
    """Make results again; return path -> SHA-256 of what was read and came out.

    Raises:
        BadInput: with the first file that does not come out as it is, or the input that changed.
    """
    inputs: dict[str, str] = {}
    for run in runs:
        start_stage("making the results again")
        for check in made_again(VerifyArguments((str(run.folder),))).record.runs:
            if check.exit_code:
                wrong = next((f for f in check.files if f.status == "differs"), None)
                place = str(Path(check.folder) / wrong.file) if wrong else check.folder
                what = "was edited since" if wrong is not None and wrong.edited else (
                    "does not come out again" if wrong else check.sentence().rstrip("."))
                raise BadInput(f"{what}, so that nothing is certified", place,
                               f"Run `ppmcal verify {run.folder}` to see what differs, then run "
                               f"{run.command} again")
        inputs |= {str(run.folder / n): digest for n, digest in run.digests.items()}
        inputs |= {_from_here(run, p): digest for p, digest in run.source.inputs.items()}
        if (run.folder / RECORD).is_file():
            inputs[str(run.folder / RECORD)] = ""
        for path in inputs:
            track_input(path)
    return inputs


def _from_here(run: RecordedRun, path: str) -> str:
    """Return the path of a run's input as it is from the working folder of now."""
    if os.path.isabs(path):
        return path
    return os.path.relpath(os.path.join(run.working_folder, path))


def _data_of(run: RecordedRun) -> list[str]:
    """Return the measurement files that a run was given."""
    return [_from_here(run, p) for p in run.data]


def _refuse_seen(folder: Path, mechanism: Mechanism, datasets: Sequence[Dataset]) -> None:
    """Refuse rows that the model was fitted to: they test nothing.

    Raises:
        BadInput: with the file.
    """
    sums = {d.source: digest_of(Path(d.source)) for d in datasets}
    for table, rows in seen_before(folder / IdentificationRecord.FILE, sums, datasets, mechanism):
        raise BadInput(f"the model was fitted to {rows}: they do not test it", table,
                       "Give measurements that no fit has seen")


def judged(mechanism: Mechanism, data: Dataset, register: Sequence[str] | None) -> JudgedRows:
    """Return a data set against a model as it is, registered as ``validate`` does.

    Raises:
        BadInput: too few rows that the model can predict, or none of a length.
    """
    model = with_and_without(mechanism)[:1]
    words = to_register(register)
    found = validated(model, (data,), words, notes=[])[0]
    asked = found.fitted if words is None else words
    whole, data = data.rows, data.take(~np.isin(data.rows, found.left_out))
    every = opened(data, tuple(w for w in REGISTERED if w in asked or (
        words is None and is_open(data, w))), words is not None)
    fit = identify(Problem(model[0].mechanism, (every,), ()),
                   FitOptions(method="flat", robust=False))
    here = residuals(fit.problem, fit.state)
    names = labels(every, mechanism)
    chosen = () if data.kind.blind else coordinates(every, mechanism.motion)
    places = len(names) if data.kind.blind else sum(c < 3 for c in chosen)
    if not places:
        raise BadInput("it measures angles alone, of which no position can be certified",
                       data.source, "Give measurements of positions, poses or distances")
    keep = finite_rows(fit.state.poses[0]) & np.isfinite(here.vector[0]).any(axis=1)
    left_out = np.setdiff1d(whole, every.rows[keep]).tolist()
    return JudgedRows(every, fit, here, keep, names, places, _by_registration(fit, len(names)),
                      tuple(left_out))


def _by_registration(fit: Fit, count: int) -> Array:
    """Return the variance (N, m) of each measured coordinate by the registration alone."""
    data = fit.problem.datasets[0]
    out = np.zeros((len(data), count))
    if data.kind.blind or not fit.problem.columns:
        return out
    covariance = prediction_covariance(fit)
    for rows in fit.problem.rows_of(0, fit.state, True):
        moves = inv(rows.whitener)[:, :count] @ rows.jacobian
        out[rows.index] = np.einsum("nmc,cd,nmd->nm", moves, covariance, moves)
    return out


def by_parameters(rows: JudgedRows, names: Sequence[str], covariance: Array) -> Array:
    """Return the variance (R, m) of measured coordinates by a machine's parameters (C, C), SI.

    Of at most :data:`SPREAD` rows, evenly spread.

    What the registration takes over is not in it: the rows are registered anew, and so is whatever
    of the parameters acts like a frame or target that stands elsewhere.
    """
    fit, mechanism = rows.fit, rows.fit.problem.mechanism
    free = tuple(mechanism.names.index(n) for n in names)
    problem = replace(fit.problem, free=free)
    kept = np.flatnonzero(rows.keep)
    some = kept[np.linspace(0, kept.size - 1, min(kept.size, SPREAD)).astype(int)]
    chosen = np.zeros_like(rows.keep)
    chosen[some] = True
    parts = list(problem.rows_of(0, fit.state, True, chosen))
    white = np.concatenate([p.jacobian.reshape(-1, p.jacobian.shape[-1]) for p in parts])
    own, nuisance = white[:, :len(free)], white[:, len(free):]
    taken = pinv(nuisance) @ own if nuisance.shape[1] else np.zeros((0, len(free)))
    out, begin = list[Array](), 0
    for p in parts:
        end = begin + p.jacobian.shape[0] * p.jacobian.shape[1]
        left = (own[begin:end] - nuisance[begin:end] @ taken).reshape(*p.jacobian.shape[:2], -1)
        moves = inv(p.whitener)[:, :len(rows.names)] @ left
        out.append(np.einsum("nmc,cd,nmd->nm", moves, covariance, moves))
        begin = end
    return np.concatenate(out)


def joint_deviations(rows: JudgedRows) -> Array:
    """Return how far each joint is from its commanded value, by the measured poses (R, k).

    Unit of q, to first order of the limbs' misclosure; nan where the pose is not fully measured.
    """
    mechanism, data = rows.fit.problem.mechanism, rows.data
    out = np.full(rows.fit.problem.joints(0, rows.fit.state).shape, np.nan)
    motion = mechanism.motion
    if data.kind.blind or data.kind.scalar or (motion.turns and not data.kind.sees_rotation):
        return out[rows.keep]
    position, rotation = data.position.copy(), data.rotation.copy()
    if motion.planar:
        position[:, 2], rotation[:, :2] = 0.0, 0.0
    if not motion.turns:
        rotation = np.zeros_like(rotation)
    joints = rows.fit.problem.joints(0, rows.fit.state)
    whole = finite_rows(position) & finite_rows(rotation) & finite_rows(joints)
    q, environment = joints[whole], environment_of(mechanism, data).take(whole)
    pose = carried_back(mechanism, rows.fit.state.registrations[0],
                        np.concatenate([position, rotation], axis=1)[whole])
    model = shifted(Model(mechanism, rows.fit.state.g), environment, q, pose)
    if model.shift is not None and model.shift.pose is not None:
        pose = moved(pose, -model.shift.pose)
    closure = model.closure(q)
    gaps = closure.lengths(pose)
    out[whole] = np.einsum("nkd,nd->nk", -pinv(closure.joint_matrix(pose)), gaps)
    return np.asarray(out[rows.keep])
