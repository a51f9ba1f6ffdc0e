"""The files of a diagnosis besides its record: model.yaml, effects.csv, next.csv and others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ppmcal.calibration.validation import residuals
from ppmcal.diagnosis.result import Candidate, Diagnosis
from ppmcal.io import write_mechanism
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_tables import residuals_csv
from ppmcal.io.results.other_models import other_files
from ppmcal.io.results.record import Column, table_text
from ppmcal.io.results.tables import WrittenTable, joint_columns
from ppmcal.model.dataset import ZERO_CELSIUS
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.store.output import Content

EFFECT_TABLE = WrittenTable("effects.csv", ("p_value", "survival", "probability").__contains__)


def files(result: Diagnosis, provenance: Mapping[str, Any], record: DiagnosisRecord
          ) -> dict[str, Content]:
    """Return file name -> text of everything that diagnose writes but pictures."""
    found, fit = result.identification, result.identification.fit
    alone = residuals(result.before.problem, result.before.state)
    out: dict[str, Content] = {
        "model.yaml": write_mechanism(
            found.mechanism,
            f"diagnosed by ppmcal {provenance.get('version', '')}: {result.verdict}; from "
            + ", ".join(d.name for d in fit.problem.datasets)),
        "effects.csv": effects_csv(result),
        "residuals.csv": residuals_csv(fit, found.before, found.after, alone),
        record.FILE: record.text(),
        "identification.json": IdentificationRecord.of(found, provenance, "prior").text(),
    }
    for name, other in other_files(result):
        what = ("fitted by ppmcal without the effects of model.yaml" if other.bare else
                f"diagnosed by ppmcal: {other.effect or 'nothing'} in place of "
                f"{other.instead or 'nothing'}")
        out[name] = write_mechanism(other.mechanism, what)
    if result.proposal.rows:
        out["next.csv"] = next_csv(result)
    return out


def effects_csv(result: Diagnosis) -> str:
    """Return effects.csv: one row per candidate, in the order of what became of it.

    ``p_value`` is empty: what was found has the smallest of thousands.
    """
    mechanism, some, none = result.identification.mechanism, result.candidates, result.untestable
    unknown, blank = [np.nan] * len(none), [""] * len(none)
    return table_text([
        Column("kind", [*(c.hypothesis.family for c in some), *(u.kind for u in none)]),
        Column("on", [*(" ".join(c.hypothesis.on) for c in some), *blank]),
        Column("form", [*("shared" if c.hypothesis.shared else "each" for c in some), *blank]),
        Column("p_value", [np.nan] * (len(some) + len(none))),
        Column("survival", [*(c.visibility for c in some), *unknown]),
        Column("status", [*(c.status for c in some), *["not testable"] * len(none)]),
        Column("alternatives", [*("; ".join(c.alternatives) for c in some),
                                *(f"needs {', '.join(u.missing)}" for u in none)]),
        Column("side", [*(_side(result, c) for c in some), *blank]),
        Column("probability", [*(c.probability for c in some), *unknown]),
    ], mechanism.units)


def _side(result: Diagnosis, candidate: Candidate) -> str:
    """Return whether the joints of what is named lag or lead their readings, joint by joint."""
    mine, mechanism = candidate.hypothesis, result.identification.mechanism
    sides = {e.on: side for e in result.effects if candidate.status == "named" and (
        e.hypothesis.family, e.hypothesis.on) == (mine.family, mine.on)
        and (side := e.side(mechanism))}
    if len(set(sides.values())) < 2:
        return next(iter(sides.values()), "")
    return "; ".join(f"{' '.join(on)} {side}" for on, side in sides.items())


def next_csv(result: Diagnosis) -> str:
    """Return next.csv: joints, poses and settings of the measurements to take."""
    mechanism, wanted = result.identification.mechanism, result.proposal
    columns = [Column(name, q) for name, q in joint_columns(mechanism, wanted.q, "q_{}").items()]
    columns += [Column(POSE_COORDINATES[c], wanted.pose[:, c], "length" if c < 3 else "angle")
                for c in mechanism.dof]
    for name, values in wanted.columns.items():
        if name.startswith("vel_"):
            a = mechanism.actuators.index(name.removeprefix("vel_"))
            values = values / mechanism.joint_units[a][0]
        columns.append(Column(name, values - ZERO_CELSIUS if name.startswith("temperature")
                              else values))
    return table_text(columns, mechanism.units)
