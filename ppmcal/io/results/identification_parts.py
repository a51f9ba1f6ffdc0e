"""Parts of identification.json: estimates, errors, noise, data sets, covariance, known rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any

import numpy as np

from ppmcal.calibration.fit import (
    DefiningParameters,
    Fit,
    SessionKnowledge,
    data_rows,
    half_interval,
    half_or,
    of_data,
)
from ppmcal.calibration.interpretation import known_rows
from ppmcal.calibration.knowledge import Considered, Estimate
from ppmcal.calibration.sessions import defining_parameters, session_knowledge
from ppmcal.calibration.validation import Dependence, Identification
from ppmcal.codec import in_units
from ppmcal.io.pose_fields import factors
from ppmcal.io.results.parts import ErrorSize, LeftOutRow, UncertainValue
from ppmcal.io.results.record import Finite, Flag, Part, Text, Whole
from ppmcal.io.results.units import MachineUnits, Numbers, column_factor
from ppmcal.linalg import Array
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.recorded import RecordedForm
from ppmcal.model.registration import DefinedFrame, Registration
from ppmcal.model.same_rows import CARRIED, KnownRows
from ppmcal.units import LARGEST, Angle, Key, Length, OfUnit, Units
from ppmcal.wording import number, pluralize


class ParameterEstimate(Part):
    """One parameter, all in ``unit`` but ``of_tolerance`` (sigma over tolerance).

    ``low``, ``high``: the 95 % interval, disagreement of sessions counted; ``sigma``: by noise
    alone, prior included; ``sigma_data``: without the prior; ``sigma_sessions``: half of
    the interval over 1.96, None where that is by noise alone; ``sessions``:
    by each alone; ``disagree_p`` of those having one value; ``disagree``: if surely not;
    ``half_noise``: half of the 95 % interval by noise alone; ``far``: whether it is farther from
    nominal than tolerances allow.
    """

    name: Text = ""
    nominal: OfUnit[Finite | None] = None
    value: OfUnit[Finite | None] = None
    error: OfUnit[Finite | None] = None
    sigma: OfUnit[Finite | None] = None
    sigma_data: OfUnit[Finite | None] = None
    low: OfUnit[Finite | None] = None
    high: OfUnit[Finite | None] = None
    tolerance: OfUnit[Finite | None] = None
    unit: Text = ""
    status: Text = ""
    of_tolerance: Finite | None = None
    sigma_sessions: OfUnit[Finite | None] = None
    sessions: tuple[UncertainValue, ...] = ()
    disagree_p: Finite | None = None
    disagree: Flag | None = None
    half_noise: OfUnit[Finite | None] = None
    far: Flag | None = None

    @classmethod
    def of(cls, e: Estimate, units: Units) -> ParameterEstimate:
        """Return the entry of an estimate in file units."""
        (low, high), f = e.interval or (None, None), units.factor(e.quantity)
        share = None if e.sigma is None or not e.tolerance or not np.isfinite(e.tolerance) else (
            e.sigma / e.tolerance)
        return cls.filled(
            e, units, low=low, high=high, unit=e.quantity + "/unit" * e.per_unit,
            of_tolerance=share, sigma_sessions=None if e.half is None else e.carried,
            sessions=tuple(UncertainValue(session=label, value=value / f, sigma=sigma / f,
                                          half=half / f)
                           for label, value, sigma, half in e.by_session),
            disagree_p=e.p_value, disagree=e.disagree if e.by_session else None,
            half_noise=e.half_by_noise, far=None if e.expected is None else e.far)

    @property
    def half(self) -> float | None:
        """Half of the 95 % interval, None without one."""
        return half_interval(self.low, self.high, self.sigma)

    @property
    def by_noise(self) -> float | None:
        """Half of the 95 % interval by noise alone, None without one."""
        return half_or(self.half_noise, self.sigma)

    @property
    def status_words(self) -> str:
        """Its status, and whether sessions surely have other values of it."""
        return self.status + ", sessions disagree" * bool(self.disagree)

    @property
    def tolerances(self) -> float | None:
        """How many tolerances the error is, None without one."""
        return abs(self.error) / self.tolerance if (
            self.error is not None and self.tolerance) else None


def combination_in_units(d: Dependence, mechanism: Mechanism) -> Dependence:
    """Return a redundant quantity; one file unit of it acts like these amounts of the others."""
    own = column_factor(mechanism, d.name)
    return Dependence(d.name, {n: v * own / column_factor(mechanism, n)
                               for n, v in d.depends_on.items()})


Summaries = Mapping[Text, ErrorSize]
"""Statistics by kind of error: position, rotation, closure, height, distance."""


class ErrorStages(Part):
    """Errors by kind in the rows in use: as ``before_is`` says, of geometry alone, of the model.

    ``holdout``: of the model, on what was held out. Where geometry alone misses by more than the
    machine did before it: ``own_rows``, its errors without the ``left_out`` rows that its own fit
    left out.
    """

    before_is: Text = ""
    before: Summaries = field(default_factory=dict)
    geometry: Summaries = field(default_factory=dict)
    after: Summaries = field(default_factory=dict)
    holdout: Summaries = field(default_factory=dict)
    own_rows: Summaries | None = None
    left_out: Whole | None = None

    def sentence(self, more: bool) -> str:
        """Return the sizes and what before is, empty where the file does not say."""
        sizes = self.sizes(more)
        return sizes + before_words(self.before_is) if sizes else ""

    def sizes(self, more: bool) -> str:
        """Return the rms error at each stage, empty where the file does not say.

        Args:
            more: whether the model has more than geometry.
        """
        kind = next((k for k in ("position", *self.after) if k in self.after), "")
        stages = [("before", self.before), ("geometry alone", self.geometry),
                  ("with what was found", self.after)][:3 if more else 2]
        sizes = [f"{name} {number(s[kind].rms)} {s[kind].unit}"
                 + self._why_worse(kind) * (s is self.geometry) for name, s in stages
                 if kind in s and s[kind].rms is not None]
        return f"{kind.capitalize()} error, rms: {', '.join(sizes)}." if sizes else ""


    def _why_worse(self, kind: str) -> str:
        """Return why geometry alone misses by more than before, empty if it does not."""
        was, alone = (s[kind].rms if kind in s else None for s in (self.before, self.geometry))
        if was is None or alone is None or alone <= was:
            return ""
        own = (self.own_rows or {}).get(kind)
        if self.left_out and own is not None and own.rms is not None and own.rms < alone:
            return (f" ({number(own.rms)} {own.unit} without the "
                    f"{pluralize(self.left_out, 'row')} that its own fit left out)")
        return " (its fit weighs all that is measured by its noise, with the tolerances)"


def before_words(before_is: str) -> str:
    """Return `` "Before" is the uncalibrated ...``, empty where a file does not say it."""
    return f' "Before" is {before_is}.' if before_is else ""


class CorrelatedPair(Part):
    """Two parameters whose errors are strongly correlated; ``value`` is bare."""

    a: Text = ""
    b: Text = ""
    value: Finite | None = None


def excluded_rows(fit: Fit) -> tuple[LeftOutRow, ...]:
    """Return the rows that a fit left out."""
    return tuple(LeftOutRow(dataset=d.name, row=int(d.rows[n]), reason=reason)
                 for d, reasons in zip(fit.problem.datasets, fit.reasons, strict=True)
                 for n, reason in sorted(reasons.items()))


class RegistrationEntry(Part):
    """Frame (6: length, then angle), target (3, length), rotation (3, angle), in file units.

    ``scale``: lengths that the instrument shows over true ones; ``encoder_offset``: what an encoder
    at a joint reads more than is true, in ``unit``.
    """

    frame: Numbers = ()
    target: Length[Numbers] = ()
    target_rotation: Angle[Numbers] = ()
    scale: Finite = 1.0
    encoder_offset: OfUnit[Finite | None] = None
    unit: Text = ""

    @classmethod
    def of(cls, r: Registration, units: Units, kind: InstrumentKind) -> RegistrationEntry:
        """Return the entry in file units."""
        more = {} if kind.placed is None else {"encoder_offset": r.offset, "unit": kind.quantity}
        return cls.filled(r, units, frame=r.frame_pose / factors(units), **more)

    def in_si(self, units: Units) -> Registration | None:
        """Return where the instrument stands, SI; None where the file does not say all of it."""
        parts = self.frame, self.target, self.target_rotation
        if [len(p) for p in parts] != [6, 3, 3] or any(None in p for p in parts):
            return None
        frame, target, rotation = (np.array(p, dtype=float) for p in parts)
        return Registration.of_pose(frame * factors(units), target * units.factor("length"),
                                    rotation * units.factor("angle"), self.scale)


class FittedDataset(Part):
    """A data set of a fit: its file, its ``rows``, how many were ``used``, where it stood.

    ``frame_by``: what defines its frame, where that is given so; ``recorded``: how the file has
    joints, where that is not as the mechanism file.
    """

    name: Text = ""
    source: Text = ""
    kind: Text = ""
    rows: Whole | None = None
    used: Whole | None = None
    registration: RegistrationEntry | None = None
    registration_before: RegistrationEntry | None = None
    frame_by: DefinedFrame | None = None
    recorded: RecordedForm | None = None


class CovarianceEntry(Part):
    """Covariance of all columns in file units, and the points that the frames turn about.

    ``prior``: standard deviations, None without; ``inflation``: a bare factor on the noise;
    ``data_matrix``, ``data_right``: what the data alone say of steps of the parameters, |matrix s -
    right|^2, white by the stated noise, as ``inflation`` is a factor on that; ``held``: what was
    not fitted, which the matrix takes for exact, though it may be off by ``held_sigma``;
    ``held_moved``: by how much each column errs with the error of each; ``defining``: what defines
    the frames of a machine that calibrates itself, missing where nothing does.
    """

    names: tuple[Text, ...] = ()
    prior: Numbers = ()
    inflation: Finite | None = None
    data_matrix: Annotated[tuple[Numbers, ...], Key("data.matrix")] = ()
    data_right: Annotated[Numbers, Key("data.right")] = ()
    unit_of_parameters: Annotated[Numbers, Key("data.unit_of_parameters")] = ()
    session: SessionKnowledge | None = None
    matrix: tuple[Numbers, ...] = ()
    frames_turn_about: Length[Mapping[Text, Numbers]] = field(default_factory=dict)
    held: Annotated[tuple[Text, ...] | None, Key("held.names", whole=True)] = None
    held_sigma: Annotated[Numbers, Key("held.sigma")] = ()
    held_moved: Annotated[tuple[Numbers, ...], Key("held.moved")] = ()
    defining: DefiningParameters | None = None

    @classmethod
    def of(cls, result: Identification) -> CovarianceEntry:
        """Return the entry in file units."""
        fit, units, kept = result.fit, result.mechanism.units, result.considered
        f = np.array([column_factor(result.mechanism, n) for n in result.columns])
        count = len(fit.problem.free)
        matrix, right = of_data(*data_rows(fit), count, fit.scale[:count])
        prior = tuple(1.0 / w / u if w > 0.0 else None
                      for w, u in zip(fit.prior.tolist(), f.tolist(), strict=True))
        about = {d.name: o.about
                 for d, o in zip(fit.problem.datasets, fit.problem.opens, strict=True)}
        of_machine = MachineUnits.of(result.mechanism, result.columns[:count])
        session, defining = in_units((session_knowledge(fit), defining_parameters(fit)), of_machine)
        return cls.filled(
            None, units, names=result.columns, prior=prior, inflation=fit.noise,
            data_matrix=matrix * f[:count] * fit.noise, data_right=right * fit.noise,
            unit_of_parameters=fit.scale[:count] / f[:count], session=session,
            matrix=result.covariance / np.outer(f, f), frames_turn_about=about,
            **_held(kept, result.mechanism, f), **({"defining": defining} if defining else {}))


def _held(kept: Considered | None, mechanism: Mechanism, columns: Array) -> dict[str, Any]:
    """Return parameters that were held, as fields; ``columns``: SI value of a unit of each (C,)."""
    if kept is None or not kept.names:
        return {"held": None}
    own = np.array([column_factor(mechanism, n) for n in kept.names])
    return {"held": kept.names, "held_sigma": kept.sigma / own,
            "held_moved": kept.gain * own / columns[:, None]}


def summaries(values: Mapping[str, Mapping[str, float]], units: Units
              ) -> dict[str, ErrorSize]:
    """Return error statistics, SI, by kind in file units."""
    return {name: ErrorSize.filled(
        None, units, **parts, unit="angle" if name == "rotation" else "length")
        for name, parts in values.items()}


ANGLES = ("rx", "ry", "rz")


class RowsOfTable(Part):
    """Rows of a table, one text each, numbers in file units in the order of ``columns``.

    All, or of so many (``of``) some evenly spread; ``value`` is a height or distance; ``chance``,
    that two measurements of one pose agree in every digit, is bare.
    """

    source: Text = ""
    kind: Text = ""
    of: Whole = 0
    chance: Finite = 1.0
    columns: tuple[Text, ...] = ()
    rows: tuple[Text, ...] = ()

    @classmethod
    def of_rows(cls, known: KnownRows, mechanism: Mechanism) -> RowsOfTable:
        """Return the rows in file units."""
        table = known.table / _factors(known.columns, mechanism)
        return cls.filled(
            known, of=known.count,
            rows=tuple(",".join(f"{v:.13g}" for v in row) for row in table.tolist()))

    def known(self, mechanism: Mechanism) -> KnownRows:
        """Return the rows in SI.

        Raises:
            ValueError: they are not numbers, too large, or more or fewer than there are columns.
        """
        table = np.array([[float(v) for v in row.split(",")] for row in self.rows], dtype=float)
        table = table.reshape(len(self.rows), len(self.columns))
        if np.any(np.abs(table) > LARGEST):
            raise ValueError("too large")
        return KnownRows(self.source, self.kind, self.of, self.chance, self.columns,
                         table * _factors(self.columns, mechanism))


def rows_behind(result: Identification) -> tuple[KnownRows, ...]:
    """Return rows of the tables behind an identification, earlier ones that it carries on too."""
    found = [known_rows(d, result.mechanism.actuators) for d in result.fit.problem.datasets]
    found += result.earlier.known if result.earlier is not None else []
    return tuple(k.thinned(max(CARRIED // len(found), 1)) for k in found)


def _factors(columns: Sequence[str], mechanism: Mechanism) -> Array:
    """Return the SI values of file units of columns (c,)."""
    joints = {f"{head}{a}": f for head in ("q_", "to_q_")
              for a, (f, _) in zip(mechanism.actuators, mechanism.joint_units, strict=True)}
    length, angle = mechanism.units.factor("length"), mechanism.units.factor("angle")
    return np.array([joints[c] if c in joints else
                     angle if c.removeprefix("cmd_") in ANGLES else length for c in columns])
